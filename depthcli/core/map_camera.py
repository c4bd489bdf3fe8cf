"""Stating the camera of a depth map; its metres stay as they are."""

import math
from dataclasses import replace

from depthcli.core import scaling
from depthcli.core.text import short_repr
from depthcli.core.types import CameraSource, DepthMap, Provenance
from depthcli.errors import UsageError


def with_focal(depth: DepthMap, focal_px: float | None, hfov_deg: float | None) -> DepthMap:
    """The same depth with a given focal length; without one, with that it states.

    Args:
        depth: the map.
        focal_px: in pixels of the map.
        hfov_deg: horizontal field of view in degrees, instead of ``focal_px``.

    Raises:
        UsageError: one is out of range, or both are given.
    """
    scaling.check_camera(focal_px, hfov_deg)
    if hfov_deg is not None:
        focal_px = scaling.focal_px_of_hfov(hfov_deg, depth.width)
    if focal_px is None:
        return depth
    source = depth.provenance or Provenance()
    source = replace(source, focal_px=float(focal_px), camera_source=CameraSource.OPTION)
    return replace(depth, provenance=source)


def with_centre(depth: DepthMap, centre_px: tuple[float, float] | None) -> DepthMap:
    """The same depth with a principal point in pixels of the map; None for the one it states.

    Raises:
        UsageError: it is not two finite numbers.
    """
    if centre_px is None:
        return depth
    try:
        x, y = (float(value) for value in centre_px)
    except (TypeError, ValueError):
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise UsageError(f"a principal point is (cx, cy) in pixels, not {short_repr(centre_px)}")
    source = replace(depth.provenance or Provenance(), centre_px=(x, y))
    return replace(depth, provenance=source)
