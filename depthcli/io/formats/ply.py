"""A coloured point cloud, as binary PLY."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from depthcli.core.camera import CameraSource, focal_px_of_hfov, hfov_deg
from depthcli.core.options import one_line
from depthcli.core.point_cloud import PointCloud, point_cloud
from depthcli.core.types import DepthMap, Frame, Provenance
from depthcli.errors import Message, OutputError
from depthcli.io.depth.metadata import metadata_texts
from depthcli.io.formats.table import KEY_PREFIX

_NYU_HFOV_DEG = 63.3  # assumed if the map states no focal length
_POINT = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
_WHITE = 255
_TYPES = {"<f4": "float", "u1": "uchar"}


@dataclass(frozen=True, slots=True)
class PlyWriter:
    """Metres: x right, y down, z along the camera axis."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write one vertex for each pixel with depth; comments in the header have the metadata."""
        if not depth.is_metric:
            told = f"a point cloud needs metres, and {depth.kind} depth has none"
            raise OutputError(told, "fit it to known depth with {anchors}")
        source = depth.provenance or Provenance()
        if source.is_cropped:
            told = "the focal length of the depth is for an image of another size"
            raise OutputError(told, "give {focal_px} or {hfov} of this one")
        focal_px = source.focal_px or focal_px_of_hfov(_NYU_HFOV_DEG, depth.width)
        points = _points(point_cloud(depth, focal_px, frame))
        known = metadata_texts(depth)
        for name in ("camera", "camera_size_px"):  # focal_px and camera_source say it in ASCII
            known.pop(name, None)
        lines = ["ply", "format binary_little_endian 1.0"]
        lines += [one_line(f"comment {KEY_PREFIX}{name} {text}") for name, text in known.items()]
        lines += [f"element vertex {len(points)}"]
        lines += [f"property {_TYPES[kind]} {name}" for name, kind in _POINT]
        with path.open("wb") as file:
            file.write(("\n".join(lines) + "\nend_header\n").encode("ascii", "backslashreplace"))
            file.write(points.data)  # tofile reports no error when the disk is full
        is_known = source.focal_px and source.camera_source is not CameraSource.CARD
        if is_known or source.projection.is_other:
            return ()
        assumed = f"the point cloud assumes an hfov of {hfov_deg(focal_px, depth.width):.3g}°"
        problem = f"no focal length is known; {assumed}"
        return (Message(problem, "give the focal length or the field of view"),)


def _points(cloud: PointCloud) -> npt.NDArray[np.void]:
    points = np.empty(len(cloud), _POINT)
    for i, name in enumerate(("x", "y", "z")):
        points[name] = cloud.xyz_m[:, i]
    for i, name in enumerate(("red", "green", "blue")):
        points[name] = _WHITE if cloud.rgb is None else cloud.rgb[:, i]
    return points
