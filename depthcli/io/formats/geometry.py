"""What formats of points and meshes share, their options and the camera; normals as 16-bit PNG."""

from pathlib import Path

import numpy as np

from depthcli.core.camera import CameraSource, focal_px_of_hfov, hfov_deg
from depthcli.core.surface import Surface, surface_of
from depthcli.core.types import DepthMap, Frame, Provenance
from depthcli.errors import Message, OutputError
from depthcli.io.depth.metadata import metadata_texts, own_texts
from depthcli.io.formats.table import SOFTWARE_KEY, WriterOptions
from depthcli.io.images.png import encode_png

_NYU_HFOV_DEG = 63.3  # assumed if the map states no focal length


class SurfaceWriter(WriterOptions):
    """Formats that show a map in space."""

    def surface(self, depth: DepthMap) -> tuple[Surface, tuple[Message, ...]]:
        """The points of a map by its camera, and warnings about that."""
        focal_px, warnings = camera_of(depth)
        surface = surface_of(
            depth,
            focal_px,
            stride=self.stride,
            max_depth_m=self.max_depth_m,
            keep_edges=self.keep_edges,
        )
        if not surface.valid.any():
            raise OutputError("no point is left", "raise {max_depth_m}, or lower {stride}")
        return surface, warnings


def camera_of(depth: DepthMap) -> tuple[float, tuple[Message, ...]]:
    """The focal length of a map in pixels, and a warning if it is assumed."""
    if not depth.is_metric:
        raise OutputError(
            f"a point in space needs metres, and {depth.kind} depth has none",
            "fit it to known depth with {anchors}",
        )
    source = depth.provenance or Provenance()
    if source.is_cropped:
        raise OutputError(
            "the focal length of the depth is for an image of another size",
            "give {focal_px} or {hfov} of this one",
        )
    focal_px = source.focal_px or focal_px_of_hfov(_NYU_HFOV_DEG, depth.width)
    is_known = source.focal_px and source.camera_source is not CameraSource.CARD
    if is_known or source.projection.is_other:
        return focal_px, ()
    assumed = f"an hfov of {hfov_deg(focal_px, depth.width):.3g}° is assumed"
    advice = "give the focal length or the field of view"
    return focal_px, (Message(f"no focal length is known; {assumed}", advice),)


_HALF = 65535 / 2


class NormalsWriter(WriterOptions):
    """Red is x to the right, green y up, blue z towards the camera; -1 to 1 as 0 to 65535."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write unit normals; 0, 0, 0 where there is no depth."""
        del frame
        focal_px, warnings = camera_of(depth)
        surface = surface_of(depth, focal_px)
        stored = np.rint((surface.normals() * np.array([1, -1, -1], np.float32) + 1) * _HALF)
        stored[~surface.valid] = 0
        texts = own_texts({**metadata_texts(depth), "normals": "OpenGL"})
        texts = {SOFTWARE_KEY: texts.pop(SOFTWARE_KEY), **texts}
        path.write_bytes(encode_png(stored.astype(np.uint16), texts))
        return warnings
