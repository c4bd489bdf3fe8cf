"""Pixels of known depth, few or many, and fitting depth to them.

The fit is one of scale and shift, robust from five points on, and then follows them locally.
"""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import cv2
import numpy as np

from depthcli.core import camera, options, types
from depthcli.errors import InputError, Message, UsageError
from depthcli.io.images.pixels import turn_beside, upright_places
from depthcli.known.local_correction import log_correction

_COLUMNS = 3
_MAX_PIXEL = 2**31
_SAME_ASPECT = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class KnownDepth:
    """Pixels of known depth."""

    x: types.Int64Array  #: (N,), columns from 0 at the left
    y: types.Int64Array  #: (N,), rows from 0 at the top
    depth_m: types.Float64Array  #: (N,), metres along the camera axis
    size_px: tuple[int, int] | None = None  #: (columns, rows) of their map; None for a list
    warnings: tuple[str, ...] = ()  #: about their file, or why it has none, one line each
    fit: options.DepthFit | None = (
        None  #: how depth is fitted; None for the best that the model can
    )
    may_be_outside: bool = False  #: whether most can be outside the image, as those of a lidar
    may_be_stored: bool = False  #: whether their map may be as the sensor gives it, not upright

    @classmethod
    def of(cls, points: Sequence[camera.Anchor]) -> Self:
        """Points from a list."""
        return cls.of_table(np.array(points, np.float64).reshape(-1, _COLUMNS))

    @classmethod
    def of_table(cls, table: types.AnyArray) -> Self:
        """Points from (N, 3) numbers: column, row, metres; each is of the nearest pixel.

        Those without a depth or a place, such as of NaN or 0 m, are left out and counted in a
        warning, unless none is left.
        """
        table = table.astype(np.float64)
        lowest, highest = camera.DEPTH_M_RANGE
        is_known = np.isfinite(table).all(axis=1)
        is_known &= (table[:, 2] >= lowest) & (table[:, 2] <= highest)
        some, lost = table[is_known], np.count_nonzero(~is_known)
        problem = f"{lost} of {len(table)} points are behind the camera or not finite"
        warnings = (f"{problem}, and are not used",) if 0 < lost < len(table) else ()
        x, y = np.rint(some[:, :2]).clip(-_MAX_PIXEL, _MAX_PIXEL).astype(np.int64).T
        return cls(x, y, some[:, 2], warnings=warnings).doubted()

    @classmethod
    def of_map(cls, depth_m: types.FloatArray) -> Self:
        """The pixels of a sparse map, (H, W) metres, that have a depth from 1 mm to 1000 km."""
        y, x = np.nonzero(
            (depth_m >= camera.DEPTH_M_RANGE[0]) & (depth_m <= camera.DEPTH_M_RANGE[1])
        )
        height, width = depth_m.shape
        return cls(x, y, depth_m[y, x].astype(np.float64), (width, height))

    def __len__(self) -> int:
        return len(self.depth_m)

    def listed(self) -> tuple[camera.Anchor, ...]:
        """The points of a list; none if they are from a map."""
        if self.size_px is not None:
            return ()
        points = zip(self.x.tolist(), self.y.tolist(), self.depth_m.tolist(), strict=True)
        return tuple(camera.Anchor(*point) for point in points)

    def doubted(self, advice: str = "give metres") -> Self:
        """The points, with a warning if their numbers are hardly metres."""
        fact = types.doubt_of_metres(float(np.median(self.depth_m))) if len(self) else ""
        warning = Message(f"known depth may be in another unit: {fact}", advice)
        return replace(self, warnings=(*self.warnings, warning)) if fact else self

    def sha256(self) -> str:
        """Checksum of the points, 64 hex digits."""
        digest = hashlib.sha256(repr((self.size_px, self.fit)).encode())
        for values in (self.x.astype("<i8"), self.y.astype("<i8"), self.depth_m.astype("<f8")):
            digest.update(values.tobytes())
        return digest.hexdigest()

    def within(self, width: int, height: int) -> Self:
        """Points in an image of this size, with a warning about the others.

        Points of a map of another size and the same aspect, such as the lidar map of a phone, are
        scaled to the image.
        """
        if not len(self):
            raise UsageError(
                f"there are no known points to fit the map to; give {camera.DEPTH_M.what}"
            )
        points = self._scaled(width, height)
        inside = (points.x >= 0) & (points.x < width) & (points.y >= 0) & (points.y < height)
        outside = int(np.count_nonzero(~inside))
        if not outside:
            return points
        problem = f"{outside} of {len(self)} known points are outside the image of {width}×{height}"
        if outside == len(self) or (2 * outside > len(self) and not self.may_be_outside):
            raise UsageError(f"{problem}; give columns and rows of the upright image")
        return replace(
            points.where(inside), warnings=(*self.warnings, f"{problem} and are not used")
        )

    def beside(self, image_px: tuple[int, int], orientation: int) -> Self:
        """The points in an image of this size that its EXIF turned, as their map where it may be.

        A warning says where the size does not tell.
        """
        if not (self.may_be_stored and self.size_px) or orientation == 1:
            return self
        turn = turn_beside(self.size_px, image_px, orientation)
        warning = (
            f"EXIF turned the image (orientation {orientation}); its depth is taken as upright"
        )
        places = np.column_stack([self.x, self.y]).astype(np.float64) + 0.5
        places, size_px = upright_places(places, self.size_px, turn or 1)
        x, y = np.floor(places).astype(np.int64).T
        warnings = (*self.warnings, warning) if turn is None else self.warnings
        return replace(self, x=x, y=y, size_px=size_px, warnings=warnings, may_be_stored=False)

    def where(self, mask: types.BoolArray) -> Self:
        """Those for which a mask (N,) is true."""
        return replace(self, x=self.x[mask], y=self.y[mask], depth_m=self.depth_m[mask])

    def _scaled(self, width: int, height: int) -> Self:
        """Points of a map, at the pixels of an image of another size."""
        if self.size_px in (None, (width, height)):
            return self
        columns, rows = self.size_px
        if abs(columns * height / (rows * width) - 1) > _SAME_ASPECT:
            raise UsageError(
                f"the known depth is {columns}×{rows} pixels, and the image {width}×{height}, "
                "which is another aspect"
            )
        x = np.floor((self.x + 0.5) * width / columns).astype(np.int64)
        y = np.floor((self.y + 0.5) * height / rows).astype(np.int64)
        return replace(self, x=x, y=y, size_px=(width, height))


def pixels_of(
    points: KnownDepth, windows: types.Windows | None
) -> tuple[types.Int64Array, types.Int64Array]:
    """Columns and rows of points of the display window, in the pixels of the file: (N,) each."""
    rows, columns = windows.display.within(windows.pixels) if windows else (slice(0), slice(0))
    return points.x + (columns.start or 0), points.y + (rows.start or 0)


_STEPS = 50
_NORMAL = 1.4826  # standard deviation over median absolute deviation, of a normal distribution
_CUTOFF = 4.685  # 95 % efficiency for normal errors
_EXACT = 1e-6  # relative; depth maps are float32
_SETTLED = 1e-12  # of scale and shift
_MOST = 100_000  # points in each step
_NEAR = 0.01  # of the longer side
# Of held-out pairs, by docs/error_with_points.py: factor, power of the error without points, and of
# the distance to the nearest; of a fit that follows none of them, of 1 + 1 / points.
_ERROR_LAWS = {
    options.DepthFit.GLOBAL: (1.15, 1.287, 0.933),
    options.DepthFit.LOCAL: (7.9, 1.594, 0.757),
    options.DepthFit.NETWORK: (5.04, 1.425, 0.782),
}


class ScaleShift(NamedTuple):
    """target = scale · value + shift."""

    scale: float
    shift: float


@dataclass(frozen=True, slots=True)
class Pairs:
    """Values and what they should become."""

    values: types.Float64Array  #: (N,)
    targets: types.Float64Array  #: (N,)
    unit: types.Float64Array  #: (N,), above 0, in which the error of each pair is measured
    error_sd: float = 1.0  #: expected standard deviation of the errors, in their units
    shift_sd: float = math.inf  #: that of the shift, in the median unit; infinite if not known
    centre: float = field(init=False)  #: median of the absolute values; 1 if that is 0
    median_unit: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", float(np.median(np.abs(self.values))) or 1.0)
        object.__setattr__(self, "median_unit", float(np.median(self.unit)))

    def errors(self, fit: ScaleShift) -> types.Float64Array:
        """Absolute error of each pair, in its unit: (N,) float64."""
        return np.abs(fit.scale * self.values + fit.shift - self.targets) / self.unit

    def thinned(self) -> "Pairs":
        """At most 100,000 pairs, evenly spaced in their order."""
        count = len(self.values)
        chosen = np.linspace(0, count - 1, min(count, _MOST)).astype(np.int64)
        some = self.values[chosen], self.targets[chosen], self.unit[chosen]
        return Pairs(*some, self.error_sd, self.shift_sd)


def least_squares(pairs: Pairs, weights: types.Float64Array | None = None) -> ScaleShift:
    """The most probable scale and shift if all errors and the shift are normally distributed.

    Values are not all equal, or the shift is expected to be finite. Weights are (N,) float64.
    """
    weights = np.ones_like(pairs.values) if weights is None else weights
    centre, unit = pairs.centre, pairs.median_unit
    rows = np.stack([pairs.values / centre, np.full_like(pairs.values, unit)], axis=1)
    rows /= pairs.unit[:, None]
    weighted = rows * weights[:, None]
    normal = weighted.T @ rows + np.diag([0.0, (pairs.error_sd / pairs.shift_sd) ** 2])
    scale, shift = np.linalg.lstsq(normal, weighted.T @ (pairs.targets / pairs.unit))[0]
    return ScaleShift(float(scale) / centre, float(shift) * unit)


def robust(pairs: Pairs) -> tuple[ScaleShift, types.Float64Array]:
    """Like :func:`least_squares`, but wrong pairs have no effect.

    An MM-like estimate: the least absolute errors, then iteratively reweighted least squares with
    Tukey's biweight. Pairs farther than 4.685 standard deviations from the fit have no effect; of
    more than 100,000, this many determine it.

    Source: Holland, Welsch: Robust regression using iteratively reweighted least-squares.
    Communications in Statistics A6, 1977; Yohai: High breakdown-point and high efficiency robust
    estimates for regression. Annals of Statistics 15, 1987.

    Returns:
        The fit, and the weight of each pair in it, 0 of wrong ones: (N,) float64 in [0, 1].
    """
    some = pairs.thinned()
    least = _EXACT * float(np.median(np.abs(some.targets) / some.unit))
    fit = least_squares(some)
    some = replace(some, error_sd=max(float(np.median(some.errors(fit))), least))
    for _ in range(_STEPS):
        fit = least_squares(some, some.error_sd / np.maximum(some.errors(fit), least))
    some = replace(some, error_sd=max(_NORMAL * float(np.median(some.errors(fit))), least))
    width = _CUTOFF * some.error_sd
    for _ in range(_STEPS):
        before, fit = fit, least_squares(some, _biweights(some.errors(fit) / width))
        if abs(fit.scale - before.scale) + abs(fit.shift - before.shift) < _SETTLED:
            break
    return fit, _biweights(pairs.errors(fit) / width)


def _biweights(errors: types.Float64Array) -> types.Float64Array:
    """Tukey's biweight of errors, 0 from 1 on."""
    return (1 - np.minimum(errors, 1) ** 2) ** 2


ROBUST_FROM = 5
"""Number of points from which wrong ones are detected and left out."""

ERROR_SD, SHIFT_SD = 0.12, 0.17
"""Expected standard deviations of metric maps, relative to depth: of the errors that a fit leaves,
and of the shift that it finds. Chosen on validation images."""

_GRID_COLUMNS, _ROWS, _SPREAD_CELLS = 6, 4, 12
"""A grid over the image. Many points in fewer than 12 of its cells count as one a cell."""


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # what overflows is no depth
def fit_known_depth(
    depth: types.DepthMap,
    points: Sequence[camera.Anchor] | KnownDepth,
    windows: types.Windows | None = None,
    *,
    followed: types.BoolArray | None = None,
) -> tuple[types.DepthMap, tuple[str, ...]]:
    """Metric depth that fits known points best, and warnings about it.

    First scale and shift of least squares, with five or more points by
    :func:`robust`, which leaves wrong ones out; one point fits the scale
    alone. Of metric maps, errors are relative to the map's depth, and the shift is expected to be
    small; points of one region, such as a wall, say little about it, however many they are.
    Relative maps are fitted in depth, inverse maps in inverse depth. Of five or more points, the
    rest is then spread over the map by :func:`depthcli.known.local_correction.log_correction`,
    unless they state the fit ``global``.

    Args:
        depth: map of any kind.
        points: pixels of the map, or of its part in the display window, and their depth. Of five or
            more, those where the map has no depth are ignored.
        windows: of the image of the map; None if all of it is displayed.
        followed: (N,) which points of the image the map follows already, if a network made it of
            them; then, it stays as it is.

    Returns:
        A metric map of the same size, with the points and the fit in its provenance; NaN where the
        fit puts a pixel at or behind the camera.
    """
    points = points if isinstance(points, KnownDepth) else KnownDepth.of(points)
    displayed = types.displayed_depth(depth, windows)
    count = len(points)
    inside = points.within(displayed.width, displayed.height)
    values = displayed.values[inside.y, inside.x].astype(np.float64)
    has_value = types.has_depth(values, depth.kind)
    if len(inside) < ROBUST_FROM or not has_value.any():
        for x, y in zip(inside.x[~has_value], inside.y[~has_value], strict=True):
            raise UsageError(f"the map has no depth at {x},{y}; choose another pixel")
    points = inside.where(has_value)
    if followed is not None:
        result, used, how = depth, followed[has_value], options.DepthFit.NETWORK
    else:
        result, used, how = _followed(depth, points, values[has_value], windows)
    fitted_m = types.displayed_depth(result, windows).values[points.y, points.x]
    errors_m = np.abs(fitted_m - points.depth_m)
    errors_m = errors_m[np.isfinite(errors_m)]
    source = replace(
        depth.provenance,
        anchors=inside.listed(),
        anchor_fit=types.AnchorFit(int(used.sum()), count, float(np.median(errors_m)), how),
    )
    warnings, lost = inside.warnings, int(np.count_nonzero(depth.valid & ~result.valid))
    if lost:
        share = f"{100 * lost / depth.values.size:.3g} %"
        place = (
            "at or beyond infinity" if depth.kind is types.DepthKind.INVERSE else "at or below 0 m"
        )
        warnings += (f"{lost} pixels ({share}) are {place} after the fit and have no depth",)
    places = pixels_of(points.where(used), windows)
    error = None if depth.error is None else _error_with(depth.error, *places, how)
    return replace(result, provenance=source, error=error), warnings


def _error_with(
    error: types.Float32Array, x: types.Int64Array, y: types.Int64Array, how: options.DepthFit
) -> types.Float32Array:
    """The relative error that is expected once depth follows points: (H, W) float32."""
    factor, power, slope = _ERROR_LAWS[how]
    if how is options.DepthFit.GLOBAL:
        return np.asarray(factor * (1 + 1 / len(x)) ** slope * error**power, np.float32)
    is_away = np.ones(error.shape, np.uint8)
    is_away[y, x] = 0
    distance = cv2.distanceTransform(is_away, cv2.DIST_L2, cv2.DIST_MASK_5) / max(error.shape)
    return np.asarray(factor * error**power * (distance + _NEAR) ** slope, np.float32)


def _followed(
    depth: types.DepthMap,
    points: KnownDepth,
    values: types.Float64Array,
    windows: types.Windows | None,
) -> tuple[types.DepthMap, types.BoolArray, options.DepthFit]:
    """Fitted depth, which points it follows, and how; ``values`` are its own at the points."""
    displayed, inverse = (
        types.displayed_depth(depth, windows),
        depth.kind is types.DepthKind.INVERSE,
    )
    targets = 1 / points.depth_m if inverse else points.depth_m
    # In which cell of a coarse grid over the image each point is.
    columns = points.x * _GRID_COLUMNS // displayed.width
    cells = points.y * _ROWS // displayed.height * _GRID_COLUMNS + columns
    fit, used = _fit(values, targets, depth.kind, cells)
    if (values[used] * fit.scale + fit.shift <= 0).any():
        raise UsageError(
            "the fit puts a known point at or behind the camera; check the known depth"
        )
    fitted = depth.values * np.float32(fit.scale) + np.float32(fit.shift)
    if inverse:
        fitted = np.float32(1) / fitted
    fitted = np.where(depth.valid & types.has_depth(fitted), fitted, np.float32(np.nan))
    how = options.DepthFit.GLOBAL
    if len(used) >= ROBUST_FROM and points.fit is not options.DepthFit.GLOBAL:
        log_m, (x, y) = np.log(fitted), pixels_of(points, windows)
        at = np.stack([(y + 0.5) / depth.height, (x + 0.5) / depth.width, log_m[y, x]])
        fitted = fitted * np.exp(log_correction(log_m, at, points.depth_m, used))
        how = options.DepthFit.LOCAL
    return types.DepthMap(fitted, types.DepthKind.METRIC), used, how


def fitted(
    depth: types.DepthMap,
    points: KnownDepth | None,
    windows: types.Windows | None = None,
    followed: types.BoolArray | None = None,
) -> tuple[types.DepthMap, tuple[str, ...]]:
    """Depth of one of several images, by :func:`fit_known_depth`, and warnings about it.

    Depth is unchanged without points.

    Raises:
        InputError: the points do not fit this image, but may fit the next one.
    """
    if points is None:
        return depth, ()
    if not points and points.warnings:  # about an image that has none of its own
        return depth, points.warnings
    try:
        return fit_known_depth(depth, points, windows, followed=followed)
    except UsageError as error:
        raise InputError(str(error)) from error


def _fit(
    values: types.Float64Array,
    targets: types.Float64Array,
    kind: types.DepthKind,
    cells: types.Int64Array,
) -> tuple[ScaleShift, types.BoolArray]:
    """The best scale and shift, and which points it is fitted to.

    ``cells`` is the cell of a coarse grid that each point is in.
    """
    used = np.ones(len(values), np.bool_)
    if len(values) == 1:
        if values[0] <= 0:
            raise UsageError(
                f"the map's value at the known point is {values[0]:g}, not above 0, so it fits no "
                "scale; give two points"
            )
        return ScaleShift(float(targets[0] / values[0]), 0.0), used
    if kind is types.DepthKind.METRIC:
        expected_m = values * np.median(targets / values)
        pairs = Pairs(values, targets, expected_m, ERROR_SD, SHIFT_SD)
    elif np.ptp(values) > 0:
        pairs = Pairs(values, targets, np.ones_like(values))
    else:
        raise UsageError(
            "all known points have the same depth in the map; spread them over the scene"
        )
    if len(values) < ROBUST_FROM:
        fit = least_squares(pairs)
    else:
        fit, weights = robust(pairs)
        used = weights > 0
        count = len(np.unique(cells[used]))
        if kind is types.DepthKind.METRIC and count < min(_SPREAD_CELLS, int(used.sum())):
            # Points of a region agree with each other, whatever the shift.
            fit = least_squares(pairs, weights * min(1.0, count / weights.sum()))
    if not 0 < fit.scale < math.inf:
        raise UsageError("the known points contradict the map's order of near and far")
    return fit, used
