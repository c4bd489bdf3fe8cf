"""Files of known depth: tables and maps, clouds, reconstructions, and depth within images."""

import json
import struct
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers import made
from helpers.heifs import heic
from helpers.tiny import write_image
from PIL import Image

from depthcli.core.camera import Anchor, Intrinsics
from depthcli.core.options import DepthEncoding
from depthcli.core.types import DepthKind, DepthMap
from depthcli.errors import InputError, UsageError
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.formats.raster import FloatWriter, Png16Writer
from depthcli.io.images import heif
from depthcli.io.images.pixels import upright
from depthcli.io.images.read import read_image
from depthcli.known import clouds
from depthcli.known.clouds import read_extrinsics
from depthcli.known.files import KnownDepthFiles
from depthcli.known.sources import read_file, read_known_depth

DEPTH_M = np.full((4, 6), np.nan, np.float32)
DEPTH_M[1, 2], DEPTH_M[3, 5] = 2.5, 4.0


def test_a_table_has_its_columns_in_any_order(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(b"\xef\xbb\xbfname,depth_m,x,y\r\na,2.5,3,4\r\nb,1e1,-0.4,6.6\r\n")
    points = read_known_depth(KnownDepthFiles(str(path)))
    assert points.listed() == (Anchor(3, 4, 2.5), Anchor(0, 7, 10.0))
    path.write_bytes(b'x , y, "depth_m"\n3, 4 , 2.5\n 0, 7, "10"\n')
    assert read_known_depth(KnownDepthFiles(str(path))).listed() == points.listed()


@pytest.mark.parametrize(
    ("shape", "orientation", "is_turned", "is_told"),
    [
        ((8, 12), 6, True, False),
        ((12, 8), 6, False, False),
        ((8, 8), 8, False, True),
        ((12, 8), 3, False, True),
    ],
)
def test_a_map_as_the_sensor_gives_it_is_turned_as_exif_turned_the_image(
    shape: tuple[int, int], orientation: int, is_turned: bool, is_told: bool, tmp_path: Path
) -> None:
    """nagadomi/nunif#27, panrafal/depthy#27, google-ar/arcore-android-sdk#1075."""
    depth_m = np.linspace(1, 3, shape[0] * shape[1], dtype=np.float32).reshape(shape)
    np.save(tmp_path / "a.npy", depth_m)
    upright_m = upright(depth_m, orientation) if is_turned else depth_m
    points = read_known_depth(KnownDepthFiles(str(tmp_path / "a.npy")))
    points = points.beside(upright_m.shape[::-1], orientation)
    np.testing.assert_array_equal(upright_m[points.y, points.x], points.depth_m)
    assert points.size_px == upright_m.shape[::-1]
    assert (f"orientation {orientation}" in " ".join(points.warnings)) == is_told


@pytest.mark.parametrize("text", [b"", b"320,240,2.5\n", b"x,y,metres\n1,2,3\n", b"x,y,depth_m\n"])
def test_a_table_without_columns_or_points_is_refused(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "a.csv").write_bytes(text)
    with pytest.raises(InputError):
        read_known_depth(KnownDepthFiles(str(tmp_path / "a.csv")))


@pytest.mark.parametrize("row", [b"1,nan,1", b"1,2,far", b"1,2,\xff", b'1,2,"3'])
def test_an_invalid_row_of_a_table_is_named_by_its_line(tmp_path: Path, row: bytes) -> None:
    (tmp_path / "a.csv").write_bytes(b"x,y,depth_m\n1,2,3\n%s\n" % row)
    with pytest.raises(InputError, match=r"a\.csv, line 3"):
        read_known_depth(KnownDepthFiles(str(tmp_path / "a.csv")))


def test_rows_of_a_table_without_depth_are_left_out_and_counted(tmp_path: Path) -> None:
    rows = "".join(f"1,2,{depth}\n" for depth in ("nan", "inf", "-inf", "0", "-3", "", "1e9"))
    (tmp_path / "a.csv").write_text(f"x,y,depth_m\n{rows}5,6,2.5\n1,2\n")
    points = read_known_depth(KnownDepthFiles(str(tmp_path / "a.csv")))
    assert points.listed() == (Anchor(5, 6, 2.5),)
    assert "8 of 9 points" in points.warnings[0]


@pytest.mark.parametrize("name", ["a.csv", "a.ply", "a.npy"])
def test_numbers_that_are_hardly_metres_are_a_warning(name: str, tmp_path: Path) -> None:
    """Of every source, as drivers of depth cameras give millimetres."""
    path = tmp_path / name
    for unit, count in ((1, 0), (1000, 1)):
        if name == "a.csv":
            path.write_text(f"x,y,depth_m\n5,6,{2.5 * unit}\n7,8,{3 * unit}\n")
        elif name == "a.ply":
            trimesh = pytest.importorskip("trimesh")
            cloud = trimesh.PointCloud(np.array([[0, 0, 2.5], [1, 0, 3]]) * unit)
            path.write_bytes(cloud.export(file_type="ply"))
        else:
            np.save(path, DEPTH_M * np.float32(unit))
        assert len(read_known_depth(KnownDepthFiles(str(path), camera=CAMERA)).warnings) == count
    if name != "a.csv":
        assert not read_known_depth(KnownDepthFiles(str(path), 1000.0, camera=CAMERA)).warnings


@pytest.mark.parametrize("suffix", ["png", "exr", "npy"])
def test_sparse_map_gives_its_valid_points(tmp_path: Path, suffix: str) -> None:
    path, depth = tmp_path / f"a.{suffix}", DepthMap(DEPTH_M)
    match suffix:
        case "png":
            Png16Writer().write(depth, path)
        case "exr":
            ExrWriter().write(depth, path)
        case _:
            np.save(path, np.nan_to_num(DEPTH_M).astype(np.float64))
    points = read_known_depth(KnownDepthFiles(str(path)))
    assert points.size_px == (6, 4)
    assert (points.x.tolist(), points.y.tolist()) == ([2, 5], [1, 3])
    assert points.depth_m == pytest.approx([2.5, 4.0])


def test_maps_of_integers_have_a_scale(tmp_path: Path) -> None:
    steps = np.nan_to_num(DEPTH_M * 256).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "a.png"), steps)
    np.save(tmp_path / "a.npy", steps)
    for name in ("a.png", "a.npy"):
        points = read_known_depth(KnownDepthFiles(str(tmp_path / name), 256.0))
        assert points.depth_m == pytest.approx([2.5, 4.0])
    np.save(tmp_path / "b.npy", steps.astype(np.float32))
    floats = read_known_depth(KnownDepthFiles(str(tmp_path / "b.npy"), 256.0))
    assert floats.depth_m == pytest.approx([2.5, 4.0])
    with pytest.raises(InputError):
        read_known_depth(KnownDepthFiles(str(tmp_path / "a.npy")))
    with pytest.raises(InputError):
        read_known_depth(KnownDepthFiles(str(tmp_path / "a.csv"), 256.0))


def test_distances_along_the_ray_become_depth(tmp_path: Path) -> None:
    camera = Intrinsics(hfov_deg=60)
    focal_px = camera.focal_for(6, 4) or 0
    across, down = (np.arange(6) - 2.5) / focal_px, (np.arange(4) - 1.5) / focal_px
    np.save(tmp_path / "a.npy", 3 * np.sqrt(1 + across**2 + down[:, None] ** 2))
    points = read_known_depth(
        KnownDepthFiles(str(tmp_path / "a.npy"), None, DepthEncoding.DISTANCE, camera)
    )
    assert points.depth_m == pytest.approx(np.full(24, 3.0))
    np.save(tmp_path / "b.npy", np.full((4, 6), focal_px / 6))
    files = KnownDepthFiles(str(tmp_path / "b.npy"), None, DepthEncoding.DISPARITY, camera, 0.5)
    assert read_known_depth(files).depth_m == pytest.approx(np.full(24, 3.0))


def test_a_map_without_metres_is_refused(tmp_path: Path) -> None:
    Png16Writer().write(DepthMap(DEPTH_M, DepthKind.RELATIVE), tmp_path / "a.png")
    np.save(tmp_path / "a.npy", np.zeros((4, 6), np.float32))
    for name in ("a.png", "a.npy", "a.txt", "b.csv"):  # relative, empty, no format, missing
        with pytest.raises(InputError):
            read_known_depth(KnownDepthFiles(str(tmp_path / name)))


def test_a_folder_may_be_an_output_of_convert(tmp_path: Path) -> None:
    FloatWriter().write(DepthMap(DEPTH_M), tmp_path / "a.depth.npy")
    files = KnownDepthFiles(str(tmp_path))
    assert files.file_for("a.jpg") == tmp_path / "a.depth.npy"
    Png16Writer().write(DepthMap(DEPTH_M), tmp_path / "a.depth.png")
    with pytest.raises(InputError):
        files.file_for("a.jpg")
    (tmp_path / "a.csv").write_text("x,y,depth_m\n1,2,3\n")
    assert files.file_for("a.jpg") == tmp_path / "a.csv"


CAMERA = Intrinsics(50.0, centre_px=(31.5, 23.5), size_px=(64, 48))
POINTS = np.array([[0.0, 0, 2], [-1, 0.5, 4], [0.001, 0, 3], [0, 0, -2], [np.nan, 0, 2], [9, 0, 1]])


def test_points_are_projected_as_a_pinhole_of_known_pixels_does() -> None:
    """The nearest counts of two in a pixel; others are dropped and counted."""
    points = clouds.projected(POINTS[:5], CAMERA)
    expected = [(round(31.5 + 50 * x / z), round(23.5 + 50 * y / z), z) for x, y, z in POINTS[:2]]
    assert sorted(zip(points.x, points.y, points.depth_m, strict=True)) == sorted(expected)
    assert points.size_px == (64, 48)
    assert "2 of 5" in points.warnings[0]
    with pytest.raises(InputError, match="focal length"):
        clouds.projected(POINTS, Intrinsics(hfov_deg=60))


def test_most_points_of_a_cloud_may_be_outside_but_not_all() -> None:
    around = np.concatenate([POINTS[:2], *[POINTS[5:] * [n, 1, 1] for n in range(1, 9)]])
    points = clouds.projected(around, CAMERA).within(128, 96)  # a larger image of the same view
    assert sorted(points.depth_m) == [2, 4]
    assert points.x.tolist() in ([63 + 2, 39], [39, 63 + 2])
    assert "8 of 10" in points.warnings[0]
    with pytest.raises(UsageError, match="8 of 8"):
        clouds.projected(around[2:], CAMERA).within(64, 48)


TURNED = "0 -1 0 0.1\n0 0 -1 -0.2\n1 0 0 0.3"  # of a lidar: x forward, y to the left, z up
ROWS = TURNED.replace("\n", " ")
KITTI = f"P2: 50 0 32 0 0 50 24 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: {ROWS}"
ODOMETRY = f"P2: 50 0 32 -2.5 0 50 24 0 0 0 1 0\nTr: {ROWS.replace('0.1', '0.15')}"


TF = """transforms:
- header: {frame_id: camera_optical}
  child_frame_id: lidar
  transform:
    translation:
      x: 0.1
      y: -0.2
      z: 3.0e-1
    rotation:
      x: 0.5
      y: -0.5
      z: 0.5
      w: 0.5
"""  # as "ros2 topic echo --once /tf_static" prints it
ECHO = """At time 0.0
- Translation: [0.100, -0.200, 0.300]
- Rotation: in Quaternion (xyzw) [0.500, -0.500, 0.500, 0.500]
- Rotation: in RPY (radian) [1.571, -0.000, 1.571]
"""  # of tf2_echo, until it is interrupted
SORTED = """rotation: {w: 0.5, x: 0.5, y: -0.5, z: 0.5}
translation: {x: 0.1, y: -0.2, z: 0.3}
"""  # as programs write it that sort names
FUSION = f"extrinsic_matrix:\n- [{ROWS.replace(' ', ', ')}]"  # of ros2_camera_lidar_fusion
LIVO = """/fastlivo2_node:
  ros__parameters:
    extrin_calib:
      extrinsic_R: [1, 0, 0, 0, 1, 0, 0, 0, 1]
      Rcl: [0, -1, 0, 0, 0, -1, 1, 0, 0]
      Pcl: [0.1, -0.2, 0.3]
"""  # of FAST-LIVO2
HAND_EYE = "transformation:\n  {qw: 0.5, qx: 0.5, qy: -0.5, qz: 0.5, x: 0.1, y: -0.2, z: 0.3}"
ROS = ("0.1 -0.2 0.3 0.5 -0.5 0.5 0.5", TF, HAND_EYE, ECHO * 2, SORTED, FUSION, LIVO)


@pytest.mark.parametrize("text", [TURNED, f"{TURNED}\n0 0 0 1", KITTI, ODOMETRY, *ROS])
def test_extrinsics_take_a_cloud_to_the_camera(text: str, tmp_path: Path) -> None:
    file = tmp_path / "pose.txt"
    file.write_text(text)
    pose, warnings = read_extrinsics(file)
    np.testing.assert_allclose(pose @ [5, 1, 2, 1], [-0.9, -2.2, 5.3, 1])
    assert warnings == ()


BACK = np.linalg.inv(np.vstack([np.array(ROWS.split(), float).reshape(3, 4), np.eye(4)[3]]))
CV_MATRIX = f"!!opencv-matrix\n  rows: 4\n  cols: 4\n  dt: d\n  data: {BACK.ravel().tolist()}"
BACK_7 = [*BACK[:3, 3], -0.5, 0.5, -0.5, 0.5]
#: by name: koide3/direct_visual_lidar_calibration, Autoware's and KITTI-360's files; ROS's frames
TURNED_ROUND = {
    "calib.json": json.dumps({"results": {"init_T_lidar_camera": [], "T_lidar_camera": BACK_7}}),
    "20260101_camera.yml": f"%YAML:1.0\n---\nCameraExtrinsicMat: {CV_MATRIX}",
    "calib_cam_to_velo.txt": " ".join(map(str, BACK[:3].ravel())),
    "16.5_cam2world.txt": " ".join(map(str, BACK.ravel())),  # of NASA's geometry mapper, by a .pcd
    "tf.yaml": "header: {frame_id: os}\nchild_frame_id: rgb_optical\ntransform:\n"
    "  translation: {x: -0.3, y: 0.1, z: -0.2}\n  rotation: {x: -0.5, y: 0.5, z: -0.5, w: 0.5}",
}  # fmt: skip


@pytest.mark.parametrize("name", TURNED_ROUND)
def test_extrinsics_that_state_the_pose_of_the_camera_are_turned_round(
    name: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_text(TURNED_ROUND[name])
    pose, warnings = read_extrinsics(tmp_path / name)
    np.testing.assert_allclose(pose @ [5, 1, 2, 1], [-0.9, -2.2, 5.3, 1])
    assert len(warnings) == 1


@pytest.mark.parametrize(
    "text",
    [
        "1 2 3",
        f"{TF}---\n{TF.replace('0.1', '0.2')}",
        TF.replace("camera_optical", "base_link"),
        TF.replace("camera_optical", "camera_link"),
        TF.replace("camera_optical", "zed_left_camera_frame"),  # x forward; of depth cameras
        f"T_cam_imu: [{ROWS.replace(' ', ', ')}]",  # of Kalibr: an IMU's, not a lidar's
        f"T_BS: {{rows: 3, cols: 4, data: [{ROWS.replace(' ', ', ')}]}}",  # of EuRoC
        "0 0 0 1 1 1 1",
        "x: 1",
        "2 0 0 0 0 2 0 0 0 0 2 0",
        "1 0 0 0 0 1 0 0 0 0 -1 0",
        "",
    ],
)
def test_what_is_no_pose_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "pose.txt").write_text(text)
    with pytest.raises(InputError):
        read_extrinsics(tmp_path / "pose.txt")


def write_cloud(path: Path) -> None:
    """Points with a colour, by the library that people use."""
    if path.suffix == ".ply":
        trimesh = pytest.importorskip("trimesh")
        path.write_bytes(trimesh.PointCloud(POINTS[:5]).export(file_type="ply"))
    elif path.suffix == ".bin":
        columns = 5 if path.stem.endswith(".pcd") else 4
        np.pad(POINTS[:5], ((0, 3), (0, columns - 3))).astype("<f4").tofile(path)
    else:
        pypcd4 = pytest.importorskip("pypcd4")
        cloud = pypcd4.PointCloud.from_xyzi_points(np.column_stack([POINTS[:5], np.ones(5)]))
        compressed = "compressed" in path.stem
        cloud.save(path, pypcd4.Encoding.BINARY_COMPRESSED if compressed else pypcd4.Encoding.ASCII)


@pytest.mark.parametrize("name", ["a.ply", "a.pcd", "compressed.pcd", "kitti.bin", "nu.pcd.bin"])
def test_files_of_clouds_are_known_depth(name: str, tmp_path: Path) -> None:
    write_cloud(tmp_path / name)
    files = KnownDepthFiles(str(tmp_path / name), 2.0, camera=CAMERA)  # units per metre
    points = read_known_depth(files)
    assert sorted(points.depth_m) == pytest.approx([1, 2])
    (tmp_path / name).write_bytes(b"no cloud")
    with pytest.raises(InputError, match="not a point cloud"):
        read_file(tmp_path / name, files)


QUATERNION, SHIFT = (0.5**0.5, 0.0, 0.5**0.5, 0.0), (0.1, -0.2, 2.0)  # a quarter turn about y
WORLD = {7: (1.0, 0.2, 0.5), 9: (-1.0, 0.0, 0.0), 11: (5.0, 0.0, 0.0)}
#: column, row and point; the last has none
SEEN = [(32.2, 20.9, 7), (0.0, 47.6, 9), (10.0, 10.0, 11), (5.0, 5.0, -1)]


def write_text(folder: Path) -> None:
    rows = " ".join(f"{x} {y} {point}" for x, y, point in SEEN)
    pose = " ".join(map(str, (*QUATERNION, *SHIFT)))
    (folder / "cameras.txt").write_text("# cameras\n2 PINHOLE 64 48 50 50 32 24\n")
    images = f"# images\n1 {pose} 2 empty.jpg\n\n4 {pose} 2 hall/my room.jpg\n{rows}\n"
    (folder / "images.txt").write_text(images)
    points = "".join(f"{k} {x} {y} {z} 9 9 9 0.5 4 0\n" for k, (x, y, z) in WORLD.items())
    (folder / "points3D.txt").write_text(f"# points\n{points}")


def write_binary(folder: Path) -> None:
    """As described in COLMAP's documentation of its format."""
    camera = struct.pack("<QiiQQ4d", 1, 2, 1, 64, 48, 50, 50, 32, 24)
    (folder / "cameras.bin").write_bytes(camera)
    images = struct.pack("<Q", 2)
    for number, name, rows in ((1, b"empty.jpg", []), (4, b"hall/my room.jpg", SEEN)):
        images += struct.pack("<I7dI", number, *QUATERNION, *SHIFT, 2) + name + b"\0"
        images += struct.pack("<Q", len(rows)) + b"".join(struct.pack("<2dq", *s) for s in rows)
    (folder / "images.bin").write_bytes(images)
    points = struct.pack("<Q", len(WORLD))
    for number, place in WORLD.items():
        points += struct.pack("<Q3d3BdQ4I", number, *place, 9, 9, 9, 0.5, 2, *range(4))
    (folder / "points3D.bin").write_bytes(points)


@pytest.mark.parametrize("write", [write_text, write_binary])
def test_a_reconstruction_has_known_depth_of_its_images(write, tmp_path: Path) -> None:  # noqa: ANN001
    write(tmp_path)
    files = KnownDepthFiles(str(tmp_path))
    assert files.is_by_image
    image = write_image(tmp_path / "data/hall/my room.jpg")
    points = read_known_depth(files, image)
    # A quarter turn about y: z of the camera is -x of the world, and 2.
    assert dict(zip(points.x.tolist(), points.depth_m.tolist(), strict=True)) == pytest.approx(
        {32: 1, 0: 3}
    )
    assert points.y.tolist() == [20, 47]
    assert points.size_px == (64, 48)
    assert len(points.warnings) == 2  # its unit, and a point behind the camera
    in_metres = read_known_depth(KnownDepthFiles(str(tmp_path), scale=2.0), image)
    np.testing.assert_allclose(in_metres.depth_m, points.depth_m / 2)
    for name in ("empty.jpg", "room.jpg"):
        with pytest.raises(InputError):
            read_known_depth(files, Path(name))
    assert points.within(128, 96).x.tolist() == [65, 1]


@pytest.mark.parametrize("orientation", range(1, 9))
def test_points_of_a_reconstruction_are_on_the_upright_image(
    orientation: int, tmp_path: Path
) -> None:
    """COLMAP ignores EXIF, so that images share a camera (github.com/colmap/colmap/issues/1456)."""
    write_text(tmp_path)
    stored = np.zeros((48, 64), np.uint8)
    stored[16:24, 32:40] = stored[40:, :8] = 255  # around the points
    path = write_image(tmp_path / "hall/my room.jpg")
    Image.fromarray(stored).save(path, exif=made.exif(orientation))
    points, pixels = read_known_depth(KnownDepthFiles(str(tmp_path)), path), read_image(path).pixels
    assert points.size_px == pixels.shape[::-1]
    assert (pixels[points.y, points.x] > 200).all()


SHADES = np.arange(256, dtype=np.uint8).reshape(16, 16)


@pytest.mark.parametrize("form", ["RangeInverse", "RangeLinear"])
@pytest.mark.parametrize("orientation", [1, 6])
def test_gdepth_of_a_jpeg_is_read_upright(form: str, orientation: int, tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    facts = {"Format": form, "Near": "0.5", "Far": "8", "Units": "m"}
    path.write_bytes(made.jpeg_with_depth(made.JPEG, SHADES, orientation=orientation, **facts))
    depth = read_stored_depth(path).depth
    share = SHADES / 255
    inverse_m, linear_m = 1 / (1 / 0.5 + share * (1 / 8 - 1 / 0.5)), 0.5 + share * 7.5
    expected_m = np.rot90(inverse_m if form == "RangeInverse" else linear_m, -(orientation == 6))
    assert depth.kind is DepthKind.METRIC
    np.testing.assert_allclose(depth.values, expected_m, rtol=1e-5)


def test_dynamic_depth_after_a_jpeg_is_read(tmp_path: Path) -> None:
    Image.fromarray(SHADES).save(file := BytesIO(), "PNG")
    depth, other = file.getvalue(), b"confidence"
    facts = ('Format="RangeInverse"', 'Near="0.5"', 'Far="8"', 'Units="Meters"')
    items = (("Primary", 0), ("Depth", len(depth)), ("Confidence", len(other)))
    xmp = "".join(
        f'<Container:Item Item:Semantic="{n}" Item:Length="{size}"/>' for n, size in items
    )
    xmp += "<x " + " ".join(f"DepthMap:{fact}" for fact in facts) + "/>"
    head = made.segment(0xE1, b"http://ns.adobe.com/xap/1.0/\0" + xmp.encode())
    (tmp_path / "a.jpg").write_bytes(made.JPEG[:2] + head + made.JPEG[2:] + depth + other)
    stored = read_stored_depth(tmp_path / "a.jpg").depth
    assert stored.kind is DepthKind.METRIC
    assert (stored.values[0, 0], stored.values[-1, -1]) == (0.5, 8)


def test_gdepth_without_a_unit_is_relative_and_without_numbers_none(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    facts = {"Format": "RangeLinear", "Near": "1"}
    path.write_bytes(made.jpeg_with_depth(made.JPEG, SHADES, Far="2", **facts))
    assert read_stored_depth(path).depth.kind is DepthKind.RELATIVE
    path.write_bytes(made.jpeg_with_depth(made.JPEG, SHADES, **facts))
    with pytest.raises(InputError):
        read_stored_depth(path)
    path.write_bytes(made.JPEG)
    (tmp_path / "a.heic").write_bytes(heic(np.zeros((64, 64, 3), np.uint8)))
    for without in (path, tmp_path / "a.heic"):
        with pytest.raises(InputError):
            read_stored_depth(without)


@pytest.mark.parametrize(
    ("facts", "range_m"),
    [
        ({"representation_type": 1, "d_min": 1.498, "d_max": 4.383}, (1 / 4.383, 1 / 1.498)),
        ({"representation_type": 0, "z_near": 0.5, "z_far": 2.0}, (0.5, 2.0)),
        ({"representation_type": 2, "z_near": 0.5, "z_far": 2.0}, (0.5, 2.0)),
    ],
)
def test_depth_image_of_a_heic_is_in_metres(
    facts: object, range_m: tuple[float, float], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of an iPhone 13 Pro, whose disparity is uniform and marked as relative."""
    monkeypatch.setattr(heif, "depth_images", lambda _: [(SHADES, facts)])
    path = tmp_path / "a.heic"
    image = heic(np.zeros((64, 64, 3), np.uint8))
    path.write_bytes(image + b"<depthData:Accuracy>relative</depthData:Accuracy>")
    stored = read_stored_depth(path)
    assert stored.depth.is_metric
    assert len(stored.warnings) == 1
    values_m = stored.depth.values
    assert (values_m.min(), values_m.max()) == pytest.approx(range_m)
