"""Surface normals as 16-bit RGB PNG, in the convention of OpenGL."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from depthcli.core.surface import surface_of
from depthcli.core.types import DepthMap, Frame
from depthcli.io.depth.metadata import metadata_texts, own_texts
from depthcli.io.formats.geometry import camera_of
from depthcli.io.formats.table import SOFTWARE_KEY
from depthcli.io.images.png import encode_png

_HALF = 65535 / 2


@dataclass(frozen=True, slots=True)
class NormalsWriter:
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
