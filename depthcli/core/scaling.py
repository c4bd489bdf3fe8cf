"""Focal lengths, and fitting depth to anchors.

An object at twice the focal length looks as it does at half the distance, so a network that was
trained on one camera is right up to the ratio of focal lengths: depth ∝ focal length.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from depthcli.core.camera import FOCAL_PX, HFOV_DEG, Anchor
from depthcli.core.overscan import displayed_depth
from depthcli.core.types import DepthKind, DepthMap, Provenance
from depthcli.core.windows import Windows
from depthcli.errors import InputError, UsageError

_FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)


def check_camera(focal_px: float | None, hfov_deg: float | None) -> None:
    """Check a focal length of 0.001 to 1e8 pixels, or instead a field of view of 0.1 to 179.9°.

    Raises:
        UsageError: one is out of range, or both are given.
    """
    if focal_px is not None and hfov_deg is not None:
        raise UsageError("give the focal length or the field of view, not both")
    if focal_px is not None and not FOCAL_PX.holds(focal_px):
        raise UsageError(f"a focal length of {focal_px:g} pixels is not {FOCAL_PX.what}")
    if hfov_deg is not None and not HFOV_DEG.holds(hfov_deg):
        raise UsageError(f"a field of view of {hfov_deg:g}° is not {HFOV_DEG.what}")


def focal_px_of_hfov(hfov_deg: float, width: int) -> float:
    """Focal length in pixels of a picture ``width`` pixels wide, of a field of view in degrees.

    Raises:
        UsageError: the field of view is not from 0.1 to 179.9 degrees.
    """
    check_camera(None, hfov_deg)
    return width / 2 / math.tan(math.radians(hfov_deg) / 2)


def hfov_deg(focal_px: float, width: int) -> float:
    """Horizontal field of view in degrees of a focal length in pixels."""
    return math.degrees(2 * math.atan(width / 2 / focal_px))


def focal_px_of_35mm(focal_35mm: float, width: int, height: int) -> float:
    """Focal length in pixels of an EXIF 35-mm-equivalent one; equal diagonals are equivalent.

    Source: CIPA DCG-001, which EXIF's tag FocalLengthIn35mmFilm follows: the angle of view over the
    diagonal of the picture is that of a lens of this focal length on a frame of 36 x 24 mm.
    """
    return focal_35mm * math.hypot(width, height) / _FILM_DIAGONAL_MM


def fit_anchors(
    depth: DepthMap, points: Sequence[Anchor], *, windows: Windows | None = None
) -> DepthMap:
    """Metric depth that fits known points best, in the least-squares sense.

    One point fits the scale, two or more fit scale and shift. Metric and relative maps are fitted
    in depth, inverse maps in inverse depth.

    Args:
        depth: map of any kind.
        points: pixels of the map, or of its part in the display window, and their depth.
        windows: of the picture of the map; None if all of it is displayed.

    Returns:
        A metric map of the same size, with the points in its provenance; NaN where the fit puts a
        pixel at or behind the camera.

    Raises:
        UsageError: a point is outside, has no depth, or one that is not above 0; there are none, or
            they do not determine the fit; or the best fit puts one at or behind the camera.
    """
    if not points:
        raise UsageError("there are no anchors to fit the map to; give one or more")
    shown = displayed_depth(depth, windows)
    values = np.array([_value_at(shown, p) for p in points], np.float64)
    truth_m = np.array([p.depth_m for p in points], np.float64)
    inverse = depth.kind is DepthKind.INVERSE
    scale, shift = _fit_scale_and_shift(values, 1 / truth_m if inverse else truth_m)
    if (values * scale + shift <= 0).any():
        raise UsageError("the anchors fit no depth ahead of the camera; check their metres")
    fitted = depth.values * np.float32(scale) + np.float32(shift)
    if inverse:
        with np.errstate(divide="ignore"):
            fitted = np.float32(1) / fitted
    fitted = np.where(fitted > 0, fitted, np.float32(np.nan)).astype(np.float32)
    if not np.isfinite(fitted).any():
        raise UsageError("the anchors fit no depth that 32 bits can hold; check their metres")
    source = replace(depth.provenance or Provenance(), anchors=tuple(points))
    return DepthMap(fitted, DepthKind.METRIC, source)


def fitted(depth: DepthMap, points: Sequence[Anchor], windows: Windows | None = None) -> DepthMap:
    """Depth of one of several pictures, fitted to points; unchanged if there are no points.

    The arguments are those of :func:`fit_anchors`.

    Raises:
        InputError: the points do not fit this picture, but may fit the next one.
    """
    try:
        return fit_anchors(depth, points, windows=windows) if points else depth
    except UsageError as error:
        raise InputError(str(error)) from error


def lost_in_fit(before: DepthMap, fitted: DepthMap) -> tuple[str, ...]:
    """A warning about the pixels that a fit leaves without depth; none if there are none."""
    if fitted.values is before.values:
        return ()
    lost = int(np.isnan(fitted.values).sum()) - int(np.isnan(before.values).sum())
    if not lost:
        return ()
    share = f"{100 * lost / fitted.values.size:.3g} %"
    return (f"{lost} pixels ({share}) are at or below 0 m after the fit and have no depth",)


def _value_at(depth: DepthMap, point: Anchor) -> float:
    if not 0 < point.depth_m < math.inf:
        raise UsageError(
            f"anchor {point.x},{point.y} has a depth of {point.depth_m:g} m; give one above 0"
        )
    if not (0 <= point.x < depth.width and 0 <= point.y < depth.height):
        raise UsageError(
            f"anchor {point.x},{point.y} is outside the picture of {depth.width}×{depth.height}"
        )
    value = float(depth.values[point.y, point.x])
    if not math.isfinite(value):
        raise UsageError(f"anchor {point.x},{point.y} has no depth; choose another pixel")
    return value


def _fit_scale_and_shift(
    values: npt.NDArray[np.float64], wanted: npt.NDArray[np.float64]
) -> tuple[float, float]:
    """Scale and shift of the best line; the scale alone for a single point."""
    if len(values) == 1:
        if values[0] <= 0:
            raise UsageError(
                f"the anchor's own value in the map is {values[0]:g}, not above 0, so it fits no "
                "scale; give two anchors"
            )
        return float(wanted[0] / values[0]), 0.0
    if np.ptp(values) == 0:
        raise UsageError("all anchors have the same depth in the map; spread them over the scene")
    scale, shift = np.polyfit(values, wanted, 1)
    if scale <= 0:
        raise UsageError("the anchors contradict the map's order of near and far; check them")
    return float(scale), float(shift)
