"""Calibrations of ROS and OpenCV: what is read, and what is refused."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

import depthcli
from depthcli.core.camera import UNKNOWN_CAMERA, Intrinsics, hfov_deg
from depthcli.errors import InputError
from depthcli.io.calibration import read_calibration

if TYPE_CHECKING:
    from pathlib import Path

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
    is_distorted: bool = False,
    pixel_aspect: float = 1.0,
) -> Intrinsics:
    return Intrinsics(
        focal_px,
        hfov_deg(focal_px, width),
        centre_px,
        (width, height),
        pixel_aspect,
        is_distorted=is_distorted,
    )


EXPECTED = calibration(640, 480, 431.5, (337.8, 250.7))


@pytest.mark.parametrize("start", ["", "%YAML:1.0\n", "%YAML 1.2\n---\n", "---\n", "\ufeff"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_camera_info_of_ros(tmp_path: Path, start: str, end: str) -> None:
    path = tmp_path / "head.yaml"
    path.write_text(start + ROS, "utf-8", newline=end)
    found = read_calibration(path)
    assert found == calibration(640, 480, 431.5, (337.8, 250.7), is_distorted=True)
    path.write_text(start + TOPIC, "utf-8", newline=end)
    assert read_calibration(path) == EXPECTED


@pytest.mark.parametrize(
    "end", ["---\n", "---\n\n", "...\n", "\n \n", "---\nheight: 1\n---\n", "--- \r\n"]
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
    found = read_calibration(path)
    assert found == calibration(640, 480, 400, (337.8, 250.7), is_distorted, 1.1025)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "is not a calibration that OpenCV can read"),
        ("\0\1", "is not a calibration that OpenCV can read"),
        ("{", "is not a calibration that OpenCV can read"),
        ("[1, 2]", "is not a calibration that OpenCV can read"),
        ("just text", "is not a calibration that OpenCV can read"),
        ("<?xml version='1.0'?><a/>", "is not a calibration that OpenCV can read"),
        (
            TOPIC.replace("[431.5", "\n- 431.5"),
            r"lists as \[1, 2\] \(ros2 topic echo --flow-style\)",
        ),
        (TOPIC.replace("K:", "P:"), "has no camera_matrix; name the calibration"),
        (TOPIC.replace("width:", "columns:"), "has no image_width"),
        (TOPIC.replace("width: 640", "width: []"), "is for nan×480 pixels"),
        (TOPIC.replace("width: 640", "width: wide"), "is for nan×480 pixels"),
        (TOPIC.replace("640", "0"), "is for 0×480 pixels"),
        (TOPIC.replace("640", "640.5"), "is not a valid camera matrix"),
        (TOPIC.replace("431.5", "-431.5"), "fx -431.5"),
        (TOPIC.replace("431.5, 250.7", "0, 250.7"), "fy 0"),
        (TOPIC.replace("337.8", "'x'"), "cx nan"),
        (TOPIC.replace("337.8", "1280.5"), "cx 1280.5"),
        (TOPIC.replace("337.8", "-641"), "cx -641"),
        (TOPIC.replace("250.7", "-2390"), "cy -2390"),
        (TOPIC.replace("250.7", "961"), "cy 961"),
        (TOPIC.replace("0.0, 1.0]", "1.0]"), "not 3×3"),
        (
            TOPIC.replace("K: [431.5, 0.0, 337.8, 0.0, 431.5, 250.7, 0.0, 0.0, 1.0]", TRANSPOSED),
            "not 3×3 with 0 0 1 in the last row; write it row by row",
        ),
        ("#" + "x" * 2**20, "too large for a calibration"),
    ],
)
def test_what_is_no_calibration(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], text: str, why: str
) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=why):
        read_calibration(path)
    assert capfd.readouterr() == ("", "")


def test_a_resized_picture_has_the_point_in_its_own_pixels() -> None:
    half = EXPECTED.centre_for(320, 240)
    assert half == pytest.approx(((337.8 + 0.5) / 2 - 0.5, (250.7 + 0.5) / 2 - 0.5))
    assert EXPECTED.centre_for(640, 480) == pytest.approx((337.8, 250.7))
    assert EXPECTED.centre_for(321, 240) == EXPECTED.centre_for(321, 241)
    middle = calibration(640, 480, 400, (319.5, 239.5)).centre_for(1280, 960)
    assert middle == (639.5, 479.5)
    for size in ((640, 360), (480, 640), (323, 240)):
        with pytest.raises(InputError, match="is for 640×480 pixels, and the picture of"):
            EXPECTED.centre_for(*size)


def test_a_distorted_lens_is_a_warning() -> None:
    assert UNKNOWN_CAMERA.warnings == EXPECTED.warnings == ()
    (warning,) = replace(EXPECTED, is_distorted=True).warnings
    assert warning.endswith("rectify the pictures, and then add rectified")


@pytest.mark.parametrize("name", ["projection_matrix", "P", "p"])
def test_rectified_pictures_have_the_camera_of_the_projection_matrix(
    tmp_path: Path, name: str
) -> None:
    path = tmp_path / "camera.yaml"
    numbers = "[400, 0, 330, -48.5, 0, 400, 250, 0, 0, 0, 1, 0]"  # right camera of a stereo pair
    path.write_text(f"{TOPIC}distortion_model: equidistant\n{name}: {numbers}\n")
    assert read_calibration(path, rectified=True) == calibration(640, 480, 400, (330, 250))
    assert read_calibration(path).focal_px == 431.5
    path.write_text(ROS)
    found = depthcli.read_calibration(path, rectified=True)
    assert (found.focal_px, found.centre_px, found.warnings) == (400, (330, 250), ())


@pytest.mark.parametrize("fy", [431.5, 435.8, 427.2, 436.0, 350.0, 863.0])
def test_pixels_are_not_square_if_fx_and_fy_differ_by_more_than_a_percent(
    tmp_path: Path, fy: float
) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(TOPIC.replace("431.5, 250.7", f"{fy}, 250.7"))
    fx, found = 431.5, read_calibration(path)
    if abs(fy / fx - 1) <= 0.01:
        assert (found.focal_px, found.pixel_aspect) == (pytest.approx(math.sqrt(fx * fy)), 1)
    else:
        assert (found.focal_px, found.pixel_aspect) == (fx, pytest.approx(fy / fx))
    assert not any("square" in warning for warning in found.warnings)


@pytest.mark.parametrize("binning", [1, 2])
def test_a_region_of_interest_is_the_picture(tmp_path: Path, binning: int) -> None:
    path = tmp_path / "camera_info.yaml"
    path.write_text(TOPIC + REGION)
    found = read_calibration(path)
    assert found == calibration(320, 240, 431.5, (337.8 - 320, 250.7 - 120))
    assert found.hfov_deg == pytest.approx(2 * math.degrees(math.atan(160 / 431.5)))
    x, y = found.centre_for(320 // binning, 240 // binning)
    assert (x + 0.5) * binning - 0.5 == pytest.approx(17.8)
    assert (y + 0.5) * binning - 0.5 == pytest.approx(130.7)
    path.write_text(TOPIC + re.sub(r"\d+", "0", REGION))  # as of the whole sensor
    assert read_calibration(path) == EXPECTED
