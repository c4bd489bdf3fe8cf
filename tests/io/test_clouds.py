"""Point clouds and reconstructions as known depth."""

import struct
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.camera import Intrinsics
from depthcli.errors import InputError, UsageError
from depthcli.io.depth import clouds
from depthcli.io.depth.anchors import AnchorFiles, read_known_depth

CAMERA = Intrinsics(50.0, centre_px=(31.5, 23.5), size_px=(64, 48))
POINTS = np.array([[0.0, 0, 2], [-1, 0.5, 4], [0.001, 0, 3], [0, 0, -2], [np.nan, 0, 2], [9, 0, 1]])


def test_points_are_projected_as_a_pinhole_does() -> None:
    """The nearest counts of two in a pixel; others are dropped and counted."""
    found = clouds.projected(POINTS[:5], CAMERA)
    expected = [(round(31.5 + 50 * x / z), round(23.5 + 50 * y / z), z) for x, y, z in POINTS[:2]]
    assert sorted(zip(found.x, found.y, found.depth_m, strict=True)) == sorted(expected)
    assert found.size_px == (64, 48)
    assert "2 of 5" in found.warnings[0]


def test_most_points_of_a_cloud_may_be_outside_but_not_all() -> None:
    around = np.concatenate([POINTS[:2], *[POINTS[5:] * [n, 1, 1] for n in range(1, 9)]])
    found = clouds.projected(around, CAMERA).within(128, 96)  # a larger image of the same view
    assert sorted(found.depth_m) == [2, 4]
    assert found.x.tolist() in ([63 + 2, 39], [39, 63 + 2])
    assert "8 of 10" in found.warnings[0]
    with pytest.raises(UsageError, match="8 of 8"):
        clouds.projected(around[2:], CAMERA).within(64, 48)


def test_clouds_need_a_camera_in_pixels() -> None:
    with pytest.raises(InputError, match="focal length"):
        clouds.projected(POINTS, Intrinsics(hfov_deg=60))


TURNED = "0 -1 0 0.1\n0 0 -1 -0.2\n1 0 0 0.3"  # of a lidar: x forward, y to the left, z up
ROWS = TURNED.replace("\n", " ")
KITTI = f"P2: 50 0 32 0 0 50 24 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: {ROWS}"
ODOMETRY = f"P2: 50 0 32 -2.5 0 50 24 0 0 0 1 0\nTr: {ROWS.replace('0.1', '0.15')}"


@pytest.mark.parametrize("text", [TURNED, f"{TURNED}\n0 0 0 1", KITTI, ODOMETRY])
def test_extrinsics_take_a_cloud_to_the_camera(text: str, tmp_path: Path) -> None:
    file = tmp_path / "pose.txt"
    file.write_text(text)
    found = clouds.posed(np.array([[5000.0, 1000, 2000]]), file, 1000)
    np.testing.assert_allclose(found, [[-900, -2200, 5300]])


@pytest.mark.parametrize(
    "text", ["1 2 3", "2 0 0 0 0 2 0 0 0 0 2 0", "1 0 0 0 0 1 0 0 0 0 -1 0", ""]
)
def test_what_is_no_pose_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "pose.txt").write_text(text)
    with pytest.raises(InputError):
        clouds.read_extrinsics(tmp_path / "pose.txt")


def write_cloud(path: Path) -> None:
    """Points with a colour, by the library that people use."""
    if path.suffix == ".ply":
        trimesh = pytest.importorskip("trimesh")
        path.write_bytes(trimesh.PointCloud(POINTS[:5]).export(file_type="ply"))
    else:
        pypcd4 = pytest.importorskip("pypcd4")
        cloud = pypcd4.PointCloud.from_xyzi_points(np.column_stack([POINTS[:5], np.ones(5)]))
        compressed = "compressed" in path.stem
        cloud.save(path, pypcd4.Encoding.BINARY_COMPRESSED if compressed else pypcd4.Encoding.ASCII)


@pytest.mark.parametrize("name", ["a.ply", "a.pcd", "compressed.pcd"])
def test_files_of_clouds_are_known_depth(name: str, tmp_path: Path) -> None:
    write_cloud(tmp_path / name)
    stated = AnchorFiles(str(tmp_path / name), 2.0, camera=CAMERA)  # units per metre
    found = stated.read()
    assert sorted(found.depth_m) == pytest.approx([1, 2])
    (tmp_path / name).write_bytes(b"no cloud")
    with pytest.raises(InputError, match="not a point cloud"):
        read_known_depth(tmp_path / name, stated)


QUATERNION, SHIFT = (0.5**0.5, 0.0, 0.5**0.5, 0.0), (0.1, -0.2, 2.0)  # a quarter turn about y
WORLD = {7: (1.0, 0.2, 0.5), 9: (-1.0, 0.0, 0.0), 11: (5.0, 0.0, 0.0)}
#: column, row and point; the last has none
SEEN = [(32.2, 20.9, 7), (0.0, 47.6, 9), (10.0, 10.0, 11), (5.0, 5.0, -1)]


def write_text(folder: Path) -> None:
    seen = " ".join(f"{x} {y} {point}" for x, y, point in SEEN)
    pose = " ".join(map(str, (*QUATERNION, *SHIFT)))
    (folder / "cameras.txt").write_text("# cameras\n2 PINHOLE 64 48 50 50 32 24\n")
    images = f"# images\n1 {pose} 2 empty.jpg\n\n4 {pose} 2 hall/my room.jpg\n{seen}\n"
    (folder / "images.txt").write_text(images)
    points = "".join(f"{k} {x} {y} {z} 9 9 9 0.5 4 0\n" for k, (x, y, z) in WORLD.items())
    (folder / "points3D.txt").write_text(f"# points\n{points}")


def write_binary(folder: Path) -> None:
    """As described in COLMAP's documentation of its format."""
    camera = struct.pack("<QiiQQ4d", 1, 2, 1, 64, 48, 50, 50, 32, 24)
    (folder / "cameras.bin").write_bytes(camera)
    images = struct.pack("<Q", 2)
    for number, name, seen in ((1, b"empty.jpg", []), (4, b"hall/my room.jpg", SEEN)):
        images += struct.pack("<I7dI", number, *QUATERNION, *SHIFT, 2) + name + b"\0"
        images += struct.pack("<Q", len(seen)) + b"".join(struct.pack("<2dq", *s) for s in seen)
    (folder / "images.bin").write_bytes(images)
    points = struct.pack("<Q", len(WORLD))
    for number, place in WORLD.items():
        points += struct.pack("<Q3d3BdQ", number, *place, 9, 9, 9, 0.5, 2) + struct.pack(
            "<4I", *range(4)
        )
    (folder / "points3D.bin").write_bytes(points)


@pytest.mark.parametrize("write", [write_text, write_binary])
def test_a_reconstruction_has_known_depth_of_its_images(write, tmp_path: Path) -> None:  # noqa: ANN001
    write(tmp_path)
    stated = AnchorFiles(str(tmp_path))
    assert stated.is_by_image
    found = stated.of_image(Path("/data/hall/my room.jpg"))
    # A quarter turn about y: z of the camera is -x of the world, and 2.
    assert dict(zip(found.x.tolist(), found.depth_m.tolist(), strict=True)) == pytest.approx(
        {32: 1, 0: 3}
    )
    assert found.y.tolist() == [20, 47]
    assert found.size_px == (64, 48)
    assert len(found.warnings) == 2  # its unit, and a point behind the camera
    in_metres = AnchorFiles(str(tmp_path), scale=2.0).of_image(Path("hall/my room.jpg"))
    np.testing.assert_allclose(in_metres.depth_m, found.depth_m / 2)
    for name in ("empty.jpg", "room.jpg"):
        with pytest.raises(InputError):
            stated.of_image(Path(name))
    assert found.within(128, 96).x.tolist() == [65, 1]
