"""What stands in a point cloud: one vertex a pixel, where the camera saw it."""

import math
from pathlib import Path

import numpy as np

from depthcli._version import __version__
from depthcli.core.camera import CameraSource
from depthcli.core.types import DepthMap, Provenance
from depthcli.io.formats.geometry import PlyWriter

FLOATS = ("x", "y", "z", "nx", "ny", "nz")
POINT = np.dtype([*((name, "<f4") for name in FLOATS), *((name, "u1") for name in "rgb")])
DEPTH_M = np.array([[1, 2, 3, 4], [5, np.nan, 0, 8]], np.float32)


def seen_by(focal_px: float | None) -> DepthMap:
    return DepthMap(DEPTH_M, provenance=Provenance(focal_px=focal_px))


def points(path: Path) -> np.ndarray:
    """The vertices, read as the header describes them."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = [line for line in header.decode("ascii").splitlines() if line[:8] != "comment "]
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    assert lines[3:] == [
        *(f"property float {name}" for name in FLOATS),
        *(f"property uchar {name}" for name in ("red", "green", "blue")),
    ]
    found = np.frombuffer(body, POINT)
    assert lines[2] == f"element vertex {len(found)}"
    return found


def test_a_point_lies_on_the_ray_through_its_pixel_s_middle(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    assert PlyWriter().write(seen_by(2.0), path) == ()
    cloud = points(path)
    np.testing.assert_array_equal(cloud["z"], [1, 2, 3, 4, 5, 8])  # row by row, without the holes
    # 4 × 2 pixels of focal length 2: middles lie at ±0.5 and ±1.5 across, ±0.5 down.
    np.testing.assert_allclose(cloud["x"] / cloud["z"], [-0.75, -0.25, 0.25, 0.75, -0.75, 0.75])
    np.testing.assert_allclose(cloud["y"] / cloud["z"], [-0.25, -0.25, -0.25, -0.25, 0.25, 0.25])


def test_without_a_focal_length_nyu_s_field_of_view_is_assumed(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    (warning,) = PlyWriter().write(seen_by(None), path)
    assert "63.3°" in warning
    cloud = points(path)
    # The middles of the outer pixels are 3/4 of the way to the edges.
    edge = math.tan(math.radians(63.3 / 2))
    np.testing.assert_allclose(cloud["x"][0] / cloud["z"][0], -0.75 * edge, rtol=1e-5)
    np.testing.assert_allclose(cloud["x"][3] / cloud["z"][3], 0.75 * edge, rtol=1e-5)


def test_comments_state_software_model_and_camera(tmp_path: Path) -> None:
    source = Provenance(model="室\nend_header\n", focal_px=519.5, camera_source=CameraSource.EXIF)
    PlyWriter(keep_edges=True).write(DepthMap(DEPTH_M, provenance=source), tmp_path / "a.ply")
    assert len(points(tmp_path / "a.ply")["z"]) == (DEPTH_M > 0).sum()
    header = (tmp_path / "a.ply").read_bytes().partition(b"element")[0].decode("ascii")
    assert header.splitlines()[2:] == [
        "comment depthcli:kind metric",
        "comment depthcli:unit m",
        f"comment depthcli:software depthcli {__version__}",
        r"comment depthcli:model \u5ba4\nend_header\n",
        "comment depthcli:focal_px 519.5",
        "comment depthcli:camera_source exif",
    ]
