"""Focal lengths and fields of view.

An object at twice the focal length looks as it does at half the distance, so a network that was
trained on one camera is right up to the ratio of focal lengths: depth ∝ focal length.
"""

import math

from depthcli.core.camera_ranges import FOCAL_PX, HFOV_DEG
from depthcli.core.validation import Rule
from depthcli.errors import UsageError

_FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)


def check_camera(focal_px: float | None, hfov_deg: float | None) -> None:
    """Check a focal length of 0.001 to 1e8 pixels, or instead a field of view of 0.1 to 179.9°.

    Raises:
        UsageError: one is out of range, or both are given.
    """
    if focal_px is not None and hfov_deg is not None:
        raise UsageError("give the focal length or the field of view, not both")
    if focal_px is not None and not _holds(FOCAL_PX, focal_px):
        raise UsageError(f"a focal length of {focal_px} pixels is not {FOCAL_PX.what}")
    if hfov_deg is not None and not _holds(HFOV_DEG, hfov_deg):
        raise UsageError(f"a field of view of {hfov_deg}° is not {HFOV_DEG.what}")


def _holds(rule: Rule, value: object) -> bool:
    """Whether a value is one number, not text or several numbers, and satisfies a rule."""
    try:
        return getattr(value, "ndim", 0) == 0 and bool(rule.holds(value))
    except (TypeError, ValueError):
        return False


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


def focal_px_of_35mm(focal_35mm: float, width: float, height: float) -> float:
    """Focal length in square pixels of an EXIF 35-mm equivalent, for which diagonals are equal.

    Source: CIPA DCG-001, which EXIF's tag FocalLengthIn35mmFilm follows: the angle of view over the
    diagonal of the picture is that of a lens of this focal length on a frame of 36 x 24 mm.
    """
    return focal_35mm * math.hypot(width, height) / _FILM_DIAGONAL_MM
