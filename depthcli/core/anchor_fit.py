"""Fitting depth to points of known depth."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from depthcli.core.anchors import AnchorPoints
from depthcli.core.camera import Anchor
from depthcli.core.overscan import displayed_depth
from depthcli.core.scale_shift import Pairs, ScaleShift, least_squares, robust
from depthcli.core.types import AnchorFit, DepthKind, DepthMap, Provenance, has_depth
from depthcli.core.windows import Windows
from depthcli.errors import InputError, UsageError

ROBUST_FROM = 5
"""Number of points from which wrong ones are detected and left out."""

ERROR_SD, SHIFT_SD = 0.12, 0.17
"""Expected standard deviations of metric maps, relative to depth: of the errors that a fit leaves,
and of the shift that it finds. Chosen on validation pictures."""

_COLUMNS, _ROWS, _SPREAD_CELLS = 6, 4, 12
"""A grid over the picture. Many points in fewer than 12 of its cells count as one a cell."""

_Values = npt.NDArray[np.float64]


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # what overflows is no depth
def fit_anchors(
    depth: DepthMap,
    points: Sequence[Anchor] | AnchorPoints,
    windows: Windows | None = None,
) -> DepthMap:
    """Metric depth that fits known points best.

    Scale and shift of least squares, with five or more points by
    :func:`depthcli.core.scale_shift.robust`, which leaves wrong ones out; one point fits the scale
    alone. Of metric maps, errors are relative to the map's depth, and the shift is expected to be
    small; points of one region, such as a wall, say little about it, however many they are.
    Relative maps are fitted in depth, inverse maps in inverse depth.

    Args:
        depth: map of any kind.
        points: pixels of the map, or of its part in the display window, and their depth. Of five or
            more, those where the map has no depth are ignored.
        windows: of the picture of the map; None if all of it is displayed.

    Returns:
        A metric map of the same size, with the points and the fit in its provenance; NaN where the
        fit puts a pixel at or behind the camera.

    Raises:
        UsageError: a point is outside, has no depth, or one that is not 0.001 to 1e6 m; there are
            none, or they do not determine the fit; or the best fit puts one at or behind the
            camera; or they are from a map of another size.
    """
    points = points if isinstance(points, AnchorPoints) else AnchorPoints.of(points)
    shown = displayed_depth(depth, windows)
    points.check(shown.width, shown.height)
    values = shown.values[points.y, points.x].astype(np.float64)
    known = _known(points, values, depth.kind)
    inverse = depth.kind is DepthKind.INVERSE
    wanted = 1 / points.depth_m[known] if inverse else points.depth_m[known]
    cells = _cells_of(points, shown.width, shown.height)[known]
    fit, used = _fit(values[known], wanted, depth.kind, cells)
    if (values[known][used] * fit.scale + fit.shift <= 0).any():
        raise UsageError(
            "the fit puts an anchor at or behind the camera; check the depths of the anchors"
        )
    fitted = depth.values * np.float32(fit.scale) + np.float32(fit.shift)
    if inverse:
        fitted = np.float32(1) / fitted
    fitted = np.where(depth.valid & has_depth(fitted), fitted, np.float32(np.nan))
    result = DepthMap(fitted, DepthKind.METRIC)
    fitted_m = displayed_depth(result, windows).values[points.y, points.x]
    errors_m = np.abs(fitted_m - points.depth_m)
    errors_m = errors_m[np.isfinite(errors_m)]
    if not errors_m.size:
        raise UsageError("the anchors fit no depth that 32 bits can hold; check their metres")
    source = replace(
        depth.provenance or Provenance(),
        anchors=points.listed(),
        anchor_fit=AnchorFit(int(used.sum()), len(points), float(np.median(errors_m))),
    )
    return replace(result, provenance=source)


def fitted(
    depth: DepthMap, points: AnchorPoints | None, windows: Windows | None = None
) -> DepthMap:
    """Depth of one of several pictures, fitted to points; unchanged if no points are given.

    The arguments are those of :func:`fit_anchors`.

    Raises:
        InputError: the points do not fit this picture, but may fit the next one.
    """
    try:
        return depth if points is None else fit_anchors(depth, points, windows)
    except UsageError as error:
        raise InputError(str(error)) from error


def lost_in_fit(before: DepthMap, fitted: DepthMap) -> tuple[str, ...]:
    """A warning about the pixels that a fit leaves without depth; none if there are none."""
    if fitted.values is before.values:
        return ()
    lost = int(np.count_nonzero(before.valid & ~fitted.valid))
    if not lost:
        return ()
    share = f"{100 * lost / fitted.values.size:.3g} %"
    where = "at or beyond infinity" if before.kind is DepthKind.INVERSE else "at or below 0 m"
    return (f"{lost} pixels ({share}) are {where} after the fit and have no depth",)


def _known(points: AnchorPoints, values: _Values, kind: DepthKind) -> npt.NDArray[np.bool_]:
    """At which points the map has a value: (N,) bool."""
    known = has_depth(values, kind)
    if len(points) >= ROBUST_FROM and known.any():
        return known
    for at in np.flatnonzero(~known)[:1]:
        raise UsageError(f"anchor {points.x[at]},{points.y[at]} has no depth; choose another pixel")
    return known


def _cells_of(points: AnchorPoints, width: int, height: int) -> npt.NDArray[np.int64]:
    """In which cell of a coarse grid over the picture each point is: (N,)."""
    return points.y * _ROWS // height * _COLUMNS + points.x * _COLUMNS // width


def _fit(
    values: _Values, wanted: _Values, kind: DepthKind, cells: npt.NDArray[np.int64]
) -> tuple[ScaleShift, npt.NDArray[np.bool_]]:
    """The best scale and shift, and which points it is fitted to.

    ``cells`` is the cell of a coarse grid that each point is in.
    """
    used = np.ones(len(values), np.bool_)
    if len(values) == 1:
        if values[0] <= 0:
            raise UsageError(
                f"the anchor's own value in the map is {values[0]:g}, not above 0, so it fits no "
                "scale; give two anchors"
            )
        return ScaleShift(float(wanted[0] / values[0]), 0.0), used
    if kind is DepthKind.METRIC:
        expected_m = values * np.median(wanted / values)
        pairs = Pairs(values, wanted, expected_m, ERROR_SD, SHIFT_SD)
    elif np.ptp(values) > 0:
        pairs = Pairs(values, wanted, np.ones_like(values))
    else:
        raise UsageError("all anchors have the same depth in the map; spread them over the scene")
    if len(values) < ROBUST_FROM:
        fit = least_squares(pairs)
    else:
        fit, weights = robust(pairs)
        used = weights > 0
        count = len(np.unique(cells[used]))
        if kind is DepthKind.METRIC and count < min(_SPREAD_CELLS, int(used.sum())):
            # Points of a region agree with each other, whatever the shift.
            fit = least_squares(pairs, weights * min(1.0, count / weights.sum()))
    if not 0 < fit.scale < math.inf:
        raise UsageError("the anchors contradict the map's order of near and far; check them")
    return fit, used
