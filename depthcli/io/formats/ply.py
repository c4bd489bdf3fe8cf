"""A coloured point cloud or mesh, as binary PLY."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from depthcli.core.options import one_line
from depthcli.core.surface import Surface
from depthcli.core.types import DepthMap, Frame
from depthcli.io.depth.metadata import metadata_texts
from depthcli.io.formats.geometry import SurfaceWriter
from depthcli.io.formats.table import KEY_PREFIX

_AXES, _NORMALS, _COLOURS = ("x", "y", "z"), ("nx", "ny", "nz"), ("red", "green", "blue")
_POINT = [(name, "<f4") for name in (*_AXES, *_NORMALS)] + [(name, "u1") for name in _COLOURS]
_FACE = [("count", "u1"), ("numbers", "<u4", 3)]
_WHITE = 255
_TYPES = {"<f4": "float", "u1": "uchar"}


class PlyWriter(SurfaceWriter):
    """Metres: x right, y down, z along the camera axis; normals towards the camera."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write one vertex for each pixel with depth; comments in the header have the metadata."""
        surface, warnings = self.surface(depth)
        points = self._points(surface, frame)
        faces = self._faces(surface)
        known = metadata_texts(depth)
        for name in ("camera", "camera_size_px"):  # focal_px and camera_source say it in ASCII
            known.pop(name, None)
        lines = ["ply", "format binary_little_endian 1.0"]
        lines += [one_line(f"comment {KEY_PREFIX}{name} {text}") for name, text in known.items()]
        lines += [f"element vertex {len(points)}"]
        lines += [f"property {_TYPES[kind]} {name}" for name, kind in _POINT]
        if self.faces:
            lines += [f"element face {len(faces)}", "property list uchar uint vertex_indices"]
        with path.open("wb") as file:
            file.write(("\n".join(lines) + "\nend_header\n").encode("ascii", "backslashreplace"))
            file.write(points.data)  # tofile reports no error when the disk is full
            file.write(faces.data)
        return warnings

    def _points(self, surface: Surface, frame: Frame | None) -> npt.NDArray[np.void]:
        valid = surface.valid
        points = np.empty(int(valid.sum()), _POINT)
        xyz_m, normals = surface.xyz_m[valid], surface.normals()[valid]
        for i in range(3):
            points[_AXES[i]], points[_NORMALS[i]] = xyz_m[:, i], normals[:, i]
        if frame is None:
            rgb = np.full((len(points), 3), _WHITE, np.uint8)
        else:
            rgb = frame.pixels_8bit()[:: self.stride, :: self.stride][valid]
        for i, name in enumerate(_COLOURS):
            points[name] = rgb[:, i]
        return points

    def _faces(self, surface: Surface) -> npt.NDArray[np.void]:
        numbers = surface.faces() if self.faces else np.empty((0, 3), np.uint32)
        faces = np.empty(len(numbers), _FACE)
        faces["count"], faces["numbers"] = 3, numbers
        return faces
