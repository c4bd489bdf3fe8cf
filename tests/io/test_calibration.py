"""Calibrations of ROS and OpenCV: what is read, and what is refused."""

import json
import math
import re
import struct
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import depthcli
from depthcli.core.camera import Distortion, Intrinsics, hfov_deg
from depthcli.errors import InputError
from depthcli.io.calibration import read_calibration
from depthcli.io.images.read import undistorted

ROS = """image_width: 640
image_height: 480
camera_name: head_camera
camera_matrix:
  rows: 3
  cols: 3
  data: [431.5, 0.000000, 337.8,
         0.000000, 431.5, 250.7, 0.000000, 0.000000, 1.000000]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.1, -0.3, 0, 0, 0]
projection_matrix:
  rows: 3
  cols: 4
  data: [400, 0, 330, 0, 0, 400, 250, 0, 0, 0, 1, 0]
"""
TOPIC = """header:
  frame_id: "camera"
height: 480
width: 640
D: [0.0, 0.0, 0.0, 0.0, 0.0]
K: [431.5, 0.0, 337.8, 0.0, 431.5, 250.7, 0.0, 0.0, 1.0]
"""
REGION = """roi:
  x_offset: 320
  y_offset: 120
  height: 240
  width: 320
  do_rectify: false
"""
TRANSPOSED = "K: [431.5, 0.0, 0.0, 0.0, 431.5, 0.0, 337.8, 250.7, 1.0]"


def calibration(
    width: int,
    height: int,
    focal_px: float,
    centre_px: tuple[float, float],
    distortion: Distortion | None = None,
    pixel_aspect: float = 1.0,
) -> Intrinsics:
    return Intrinsics(
        focal_px,
        hfov_deg(focal_px, width),
        centre_px,
        (width, height),
        pixel_aspect,
        distortion=distortion,
    )


EXPECTED = calibration(640, 480, 431.5, (337.8, 250.7))


@pytest.mark.parametrize("start", ["", "%YAML:1.0\n", "%YAML 1.2\n---\n", "---\n", "\ufeff"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_camera_info_of_ros(tmp_path: Path, start: str, end: str) -> None:
    path = tmp_path / "head.yaml"
    path.write_text(start + ROS, "utf-8", newline=end)
    camera = read_calibration(path)
    distortion = Distortion((431.5, 431.5), (0.1, -0.3, 0, 0, 0))
    assert camera == calibration(640, 480, 431.5, (337.8, 250.7), distortion)
    path.write_text(start + TOPIC, "utf-8", newline=end)
    assert read_calibration(path) == EXPECTED


@pytest.mark.parametrize(
    "end",
    ["---\n", "---\n\n", "...\n", "\n \n", "---\nheight: 1\n---\n", "--- \r\n", "---\nk: [1, "],
)
def test_the_first_message_of_a_topic(tmp_path: Path, end: str) -> None:
    path = tmp_path / "head.yaml"
    path.write_text(TOPIC.lower() + end, "utf-8")
    assert read_calibration(path) == EXPECTED


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
@pytest.mark.parametrize("is_distorted", [True, False])
def test_files_of_opencv(tmp_path: Path, suffix: str, is_distorted: bool) -> None:
    path = tmp_path / f"camera.{suffix}"
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("image_width", 640)
    file.write("image_height", 480)
    file.write("camera_matrix", np.array([[400.0, 0, 337.8], [0, 441, 250.7], [0, 0, 1]]))
    file.write("distortion_coefficients", np.array([[0.0, 0, 0.1 * is_distorted, 0, 0]]))
    file.release()
    camera = read_calibration(path)
    distortion = Distortion((400, 441), (0, 0, 0.1, 0, 0)) if is_distorted else None
    assert camera == calibration(640, 480, 400, (337.8, 250.7), distortion, 1.1025)


@pytest.mark.parametrize(
    "text",
    [
        *("", "\0\1", "{", "[1, 2]", "just text", "<?xml version='1.0'?><a/>"),
        *("[" * 40_000, "K: " + "[" * 40_000, '{"K": ' + "[" * 40_000),
        TOPIC.replace("K:", "P:"),
        TOPIC.replace("width: 640", "width: wide"),
        "cam0: {camera_model: omni, intrinsics: [1, 2, 3, 4]}",
        "cam0: {intrinsics: [1, 2, 3, 4]}\ncam1: {intrinsics: [1, 2, 3, 4]}",
        "1 PINHOLE 640 480 1 2 3 4\n2 PINHOLE 640 480 1 2 3 4",
        '{"fx": 0.8, "fy": 1.07, "cx": 0.5, "cy": 0.5}',  # of MoGe, in shares of the size
        "0.8 0 0.5\n0 1.07 0.5\n0 0 1\n",
        TOPIC.replace("431.5", "0.8"),
        *(TOPIC.replace("640", columns) for columns in ("0", "640.5")),
        *(TOPIC.replace("431.5", focal_px) for focal_px in ("-431.5", "0")),
        *(TOPIC.replace("337.8", x) for x in ("'x'", "1e7")),
        TOPIC.replace("0.0, 1.0]", "1.0]"),
        TOPIC.replace("K: [431.5, 0.0, 337.8, 0.0, 431.5, 250.7, 0.0, 0.0, 1.0]", TRANSPOSED),
        "#" + "x" * 2**20,
    ],
)
def test_file_that_is_not_a_calibration_is_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], text: str
) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    with pytest.raises(InputError):
        read_calibration(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["projection_matrix", "P", "p"])
def test_rectified_images_have_the_camera_of_the_projection_matrix(
    tmp_path: Path, name: str
) -> None:
    path = tmp_path / "camera.yaml"
    numbers = "[400, 0, 330, -48.5, 0, 400, 250, 0, 0, 0, 1, 0]"  # right camera of a stereo pair
    path.write_text(f"{TOPIC}distortion_model: equidistant\n{name}: {numbers}\n")
    assert read_calibration(path, rectified=True) == calibration(640, 480, 400, (330, 250))
    assert read_calibration(path).focal_px == 431.5
    path.write_text(ROS)
    camera = depthcli.read_calibration(path, rectified=True)
    assert (camera.focal_px, camera.centre_px, camera.warnings) == (400, (330, 250), ())


@pytest.mark.parametrize("fy", [431.5, 431.9, 431.1, 434.6, 350.0, 863.0])  # .7 %: TUM's freiburg3
def test_pixels_are_not_square_if_fx_and_fy_differ_by_over_a_thousandth(
    tmp_path: Path, fy: float
) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(TOPIC.replace("431.5, 250.7", f"{fy}, 250.7"))
    camera, is_square = read_calibration(path), abs(fy / 431.5 - 1) <= 0.001
    expected = (math.sqrt(431.5 * fy), 1) if is_square else (431.5, fy / 431.5)
    assert (camera.focal_px, camera.pixel_aspect) == pytest.approx(expected)


@pytest.mark.parametrize("binning", [1, 2])
def test_a_region_of_interest_is_the_image(tmp_path: Path, binning: int) -> None:
    path = tmp_path / "camera_info.yaml"
    path.write_text(TOPIC + REGION)
    camera = read_calibration(path)
    assert camera == calibration(320, 240, 431.5, (337.8 - 320, 250.7 - 120))
    assert camera.hfov_deg == pytest.approx(2 * math.degrees(math.atan(160 / 431.5)))
    x, y = camera.centre_for(320 // binning, 240 // binning)
    assert (x + 0.5) * binning - 0.5 == pytest.approx(17.8)
    assert (y + 0.5) * binning - 0.5 == pytest.approx(130.7)
    path.write_text(TOPIC + re.sub(r"\d+", "0", REGION))  # as of the whole sensor
    assert read_calibration(path) == EXPECTED


DIALECTS = {
    "topic.yaml": TOPIC.replace("[", "\n- ").replace(", ", "\n- ").replace("]", ""),
    "topic_commented.yaml": TOPIC.replace("width: 640", "width: 640  # columns"),
    "kalibr.yaml": (
        "cam0:\n  cam_overlaps: []\n  camera_model: pinhole\n  distortion_coeffs: [0, 0, 0, 0]\n"
        "  distortion_model: radtan\n  intrinsics: [431.5, 431.5, 337.8, 250.7]\n"
        "  resolution: [640, 480]\n"
    ),
    "cameras.txt": "# Camera list\n1 PINHOLE 640 480 431.5 431.5 338.3 251.2\n",
    "simple.txt": "1 SIMPLE_RADIAL 640 480 431.5 338.3 251.2 0\n",
    "transforms.json": (
        '{"w": 640, "h": 480, "fl_x": 431.5, "fl_y": 431.5, "cx": 338.3, "cy": 251.2, "k1": 0, '
        '"frames": []}'
    ),
    "open3d.json": (
        '{"width": 640, "height": 480, '
        '"intrinsic_matrix": [431.5, 0, 0, 0, 431.5, 0, 337.8, 250.7, 1]}'
    ),
    "open3d_pose.json": (
        '{"extrinsic": [1, 0], "intrinsic": {"width": 640, "height": 480, '
        '"intrinsic_matrix": [431.5, 0, 0, 0, 431.5, 0, 337.8, 250.7, 1]}}'
    ),
    "orb_slam.yaml": (
        '%YAML:1.0\n\n# Camera\nCamera.type: "PinHole"\nCamera1.fx: 431.5\n'
        "Camera1.fy: 431.5\nCamera1.cx: 337.8\nCamera1.cy: 250.7\nCamera1.k1: 0.0\n"
        "Camera.width: 640\nCamera.height: 480\n"
    ),
    "vins.yaml": (
        "%YAML:1.0\n---\nmodel_type: PINHOLE\nimage_width: 640\nimage_height: 480\n"
        "distortion_parameters:\n   k1: 0\n   p1: 0.0\n"
        "projection_parameters:\n   fx: 4.315e+2\n   fy: 4.315e2\n   cx: 337.8\n   cy: 250.7\n"
    ),
    "kitti.txt": (
        "calib_time: 09-Jan-2012 13:57:47\nS_rect_02: 6.4e+02 4.8e+02\n"
        "P_rect_02: 431.5 0 337.8 44.8 0 431.5 250.7 0.2 0 0 1 0.002\n"
    ),
    "mast3r.yaml": "width: 640\nheight: 480\ncalibration: [431.5, 431.5, 337.8, 250.7]\n",
    "realsense.json": (
        '{"width": 640, "height": 480, "ppx": 337.8, "ppy": 250.7, "fx": 431.5, "fy": 431.5, '
        '"model": "distortion.brown_conrady", "coeffs": [0, 0, 0, 0, 0]}'
    ),
    "autoware.yml": (
        "%YAML:1.0\n---\nCameraMat: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        "   data: [431.5, 0, 337.8, 0, 431.5, 250.7, 0, 0, 1]\nDistModel: plumb_bob\n"
        "DistCoeff: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [0, 0, 0, 0, 0]\n"
        "ImageSize: [640, 480]\n"
    ),
    "fast_livo2.yaml": (
        "cam_model: Pinhole\ncam_width: 640\ncam_height: 480\nscale: 0.5\ncam_fx: 431.5\n"
        "cam_fy: 431.5\ncam_cx: 337.8\ncam_cy: 250.7\ncam_d0: 0\ncam_d1: 0\ncam_d2: 0\ncam_d3: 0\n"
    ),
    "nice_slam.yaml": "cam: {H: 480, W: 640, fx: 431.5, fy: 431.5, cx: 337.8, cy: 250.7}",
    "fields.json": (
        '{"width": 640, "height": 480, "fx": 431.5, "fy": 431.5, "cx": 337.8, "cy": 250.7}'
    ),
}
DIALECTS["replica.json"] = f'{{"camera": {DIALECTS["fields.json"]}}}'


@pytest.mark.parametrize("name", DIALECTS)
def test_calibrations_of_other_programs(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(DIALECTS[name])
    camera = read_calibration(tmp_path / name)
    assert camera.focal_px == pytest.approx(431.5)
    assert camera.centre_px == pytest.approx((337.8, 250.7))
    assert (camera.size_px, camera.distortion, camera.pixel_aspect) == ((640, 480), None, 1)


NGP = '"k1": 0.02, "k2": 0, "p1": 0, "is_fisheye": true'  # of colmap2nerf
FISHEYE = ("equidistant", "EquidistantCamera", '"KannalaBrandt8"', "SIMPLE_RADIAL_FISHEYE", NGP)


@pytest.mark.parametrize(
    ("name", "old", "new", "expected"),
    [
        ("kalibr.yaml", "[0, 0, 0, 0]", "[0, -0.28, 0, 0]", (0, -0.28, 0, 0)),
        ("kalibr.yaml", "radtan", "equidistant", (0, 0, 0, 0)),
        ("kalibr.yaml", "0]\n  distortion_model: radtan", "0.9]\n  distortion_model: fov", ()),
        ("transforms.json", '"k1": 0', '"p1": 0.2, "k2": 0.01', (0, 0.01, 0.2, 0, 0)),
        ("transforms.json", '"k1": 0', '"k4": 0.01', ()),  # not that of OpenCV
        ("transforms.json", '"k1": 0', NGP, (0.02, 0, 0, 0)),
        ("orb_slam.yaml", "k1: 0.0", "k1: 0.26", (0.26, 0, 0, 0, 0)),
        ("orb_slam.yaml", '"PinHole"', '"KannalaBrandt8"', (0, 0, 0, 0)),
        ("vins.yaml", "k1: 0", "k1: -0.1", (-0.1, 0, 0, 0)),
        ("simple.txt", "251.2 0", "251.2 0.01", (0.01, 0, 0, 0)),
        ("simple.txt", "SIMPLE_RADIAL", "SIMPLE_RADIAL_FISHEYE", (0, 0, 0, 0)),
        ("mast3r.yaml", "250.7]", "250.7, 0.26]", (0.26, 0, 0, 0)),
        ("mast3r.yaml", "250.7]", "250.7, 0.0]", None),
        ("realsense.json", "[0, 0, 0, 0, 0]", "[0, 0.1, 0, 0, 0]", (0, 0.1, 0, 0, 0)),
        ("realsense.json", "brown_conrady", "inverse_brown_conrady", None),
        ("autoware.yml", "[0, 0, 0, 0, 0]", "[0, 0.1, 0, 0, 0]", (0, 0.1, 0, 0, 0)),
        ("fast_livo2.yaml", "d1: 0", "d1: 0.1", (0, 0.1, 0, 0)),
        ("fast_livo2.yaml", "Pinhole", "EquidistantCamera", (0, 0, 0, 0)),
        ("topic.yaml", "D: \n- 0.0", "D: \n- 0.1", (0.1, 0, 0, 0, 0)),
    ],
)
def test_distortion_in_calibrations_of_other_programs(
    tmp_path: Path, name: str, old: str, new: str, expected: tuple[float, ...] | None
) -> None:
    """In the order of OpenCV; without coefficients, of a model that it lacks."""
    assert old in DIALECTS[name]
    (tmp_path / "camera.yaml").write_text(DIALECTS[name].replace(old, new))
    distortion = read_calibration(tmp_path / "camera.yaml").distortion
    assert (distortion and distortion.coefficients) == expected
    assert distortion is None or distortion.is_fisheye is (new in FISHEYE)


@pytest.mark.parametrize(
    "text",
    [
        "4.315e+02 0 3.378e+02\n0 4.315e+02 2.507e+02\n0 0 1\n",
        "431.5, 0, 337.8, 0\n0, 431.5, 250.7, 0\n0, 0, 1, 0\n0, 0, 0, 1\n",
        "[[431.5, 0, 337.8],\n [0, 431.5, 250.7],\n [0, 0, 1]]\n",
        "P0: 1 0 2 0 0 1 3 0 0 0 1 0\nP2: 431.5 0 337.8 4 0 431.5 250.7 0 0 0 1 0\n",
        "%YAML:1.0\nCamera.fx: 431.5\nCamera.fy: 431.5\nCamera.cx: 337.8\nCamera.cy: 250.7\n",
    ],
    ids=["3x3", "4x4", "of NumPy", "KITTI odometry", "ORB-SLAM 2"],
)
def test_a_calibration_without_a_size(tmp_path: Path, text: str) -> None:
    (tmp_path / "camera.txt").write_text(text)
    camera = read_calibration(tmp_path / "camera.txt")
    assert (camera.focal_px, camera.centre_px) == (pytest.approx(431.5), (337.8, 250.7))
    assert (camera.size_px, camera.hfov_deg) == (None, None)
    assert len(camera.warnings) == 1


@pytest.mark.parametrize(("model", "numbers"), [(1, [431.5, 431.5]), (2, [431.5])])
def test_a_binary_calibration_of_colmap(tmp_path: Path, model: int, numbers: list[float]) -> None:
    numbers = [*numbers, 338.3, 251.2, *([0.0] if model == 2 else [])]
    data = struct.pack("<QiiQQ", 1, 1, model, 640, 480) + struct.pack(f"<{len(numbers)}d", *numbers)
    (tmp_path / "cameras.bin").write_bytes(data)
    camera = read_calibration(tmp_path / "cameras.bin")
    assert (camera.focal_px, camera.size_px) == (pytest.approx(431.5), (640, 480))
    assert camera.centre_px == pytest.approx((337.8, 250.7))
    (tmp_path / "cameras.bin").write_bytes(data[:-1])
    with pytest.raises(InputError):
        read_calibration(tmp_path / "cameras.bin")


@pytest.mark.parametrize("is_fisheye", [False, True])
@pytest.mark.parametrize("scale", [1, 2])
def test_points_land_where_a_pinhole_sees_them_once_undistorted(
    tmp_path: Path, is_fisheye: bool, scale: int
) -> None:
    """Also in images that are larger than those of the calibration."""
    model, lens = "plumb_bob", np.array([-0.3, 0.1, 0.001, -0.002, 0.0])
    if is_fisheye:
        model, lens = "equidistant", np.array([0.05, -0.02, 0.004, -0.001])
    matrix, size = np.array([[200.0, 0, 155], [0, 200, 125], [0, 0, 1]]), (320, 240)
    fields = {"width": 320, "height": 240, "K": matrix.tolist(), "D": lens.tolist()}
    (tmp_path / "camera.json").write_text(json.dumps(fields | {"distortion_model": model}))
    camera = replace(read_calibration(tmp_path / "camera.json"), is_undistorted=True)
    project = cv2.fisheye.projectPoints if is_fisheye else cv2.projectPoints
    points = np.array([[x, y, 2.0] for x in (-1.2, 0.3, 1.3) for y in (-1, 0.2, 0.9)])
    raw = project(points[:, None], np.zeros(3), np.zeros(3), matrix, lens)[0].reshape(-1, 2)
    flat = points[:, :2] / 2 * 200 + (155, 125)
    assert np.abs(raw - flat).max() > 12
    for centre, expected in zip((raw + 0.5) * scale - 0.5, (flat + 0.5) * scale - 0.5, strict=True):
        image = np.zeros((size[1] * scale, size[0] * scale), np.uint8)
        cv2.circle(image, tuple(np.rint(centre * 16).astype(int)), 64, 255, -1, cv2.LINE_AA, 4)
        pixels = undistorted(depthcli.Frame(image), camera).pixels.astype(float)
        rows, columns = np.indices(pixels.shape)
        middle = np.array([(columns * pixels).sum(), (rows * pixels).sum()]) / pixels.sum()
        assert np.abs(middle - expected).max() < 0.3


def test_pixels_that_a_lens_does_not_show_get_no_depth() -> None:
    camera = replace(EXPECTED, distortion=Distortion((431.5, 431.5), (0.3, 0, 0, 0)))
    image = np.full((480, 640, 3), 9, np.uint8)
    frame = depthcli.Frame(image, transparent=np.indices((480, 640))[0] > 460)
    assert undistorted(frame, camera) is frame
    corrected = undistorted(frame, replace(camera, is_undistorted=True))
    assert corrected.transparent is not None
    assert corrected.transparent[[0, 250, 470], [0, 337, 337]].tolist() == [True, False, True]
    assert corrected.pixels[0, 0].tolist() == [9, 9, 9]
    other = replace(camera, distortion=Distortion((431.5, 431.5), ()), is_undistorted=True)
    with pytest.raises(InputError):
        undistorted(frame, other)
