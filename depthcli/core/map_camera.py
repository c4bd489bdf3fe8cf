"""Stating the camera of a depth map; its metres stay as they are."""

from dataclasses import replace

from depthcli.core.camera import CameraSource, Intrinsics
from depthcli.core.types import DepthMap, Provenance


def with_camera(depth: DepthMap, camera: Intrinsics) -> DepthMap:
    """Depth that states a given camera; what of it is not given stays as it is.

    Raises:
        InputError: the camera is for another aspect ratio.
    """
    source = depth.provenance or Provenance()
    found, focal_px = source, camera.focal_for(depth.width)
    centre_px = camera.centre_for(depth.width, depth.height)
    if focal_px is not None:
        found = replace(found, focal_px=focal_px, camera_source=CameraSource.OPTION)
    if centre_px is not None:
        found = replace(found, centre_px=centre_px)
    if camera.pixel_aspect is not None:
        found = replace(found, pixel_aspect=camera.pixel_aspect)
    return depth if found == source else replace(depth, provenance=found)
