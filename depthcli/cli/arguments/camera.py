"""Parsing cameras, pixels and points of known depth."""

import math
from collections.abc import Sequence

from depthcli.core.camera import DEPTH_M, Anchor, Camera
from depthcli.errors import UsageError

_PARTS = 3


def choose_camera(
    focal_px: float | None,
    hfov_deg: float | None,
    anchors: Sequence[str] | None,
    white_level: int | None = None,
) -> Camera:
    """The camera of the options.

    Raises:
        UsageError: they contradict each other, or an anchor is not X,Y,METRES.
    """
    if focal_px is not None and hfov_deg is not None:
        raise UsageError("give --focal-px or --hfov, not both")
    return Camera(focal_px, hfov_deg, tuple(map(_anchor, anchors or ())), white_level)


def parse_pixel(word: str) -> tuple[int, int]:
    """Parse ``X,Y``.

    Raises:
        UsageError: it is not two integers of at least 0.
    """
    try:
        x, y = (int(part) for part in word.split(","))
    except ValueError:
        x = y = -1
    if min(x, y) < 0:
        raise UsageError(
            f"{word!r} is not X,Y; give a column and a row from 0, for example 320,240"
        )
    return x, y


def parse_centre(word: str) -> tuple[float, float]:
    """Parse ``CX,CY``, in pixels with decimals.

    Raises:
        UsageError: it is not two finite numbers.
    """
    try:
        x, y = (float(part) for part in word.split(","))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise UsageError(
            f"--centre-px {word!r} is not CX,CY; give the principal point in pixels, for example "
            "319.5,239.5"
        )
    return x, y


def _anchor(word: str) -> Anchor:
    parts = word.split(",")
    try:
        x, y, depth_m = int(parts[0]), int(parts[1]), float(parts[2])
    except (ValueError, IndexError):
        x = y = -1
        depth_m = math.nan
    if len(parts) != _PARTS or min(x, y) < 0 or not DEPTH_M.holds(depth_m):
        raise UsageError(
            f"--anchor {word!r} is not X,Y,METRES; give a column and a row from 0 and "
            f"{DEPTH_M.what}, for example 320,240,2.5"
        )
    return Anchor(x, y, depth_m)
