"""Converted depth EXRs still line up with their plate."""

from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
from helpers.plates import CROP, DISPLAY, MIXED, OVERSCAN, Box, size_of, written

from depthcli.core.camera import Intrinsics, focal_px_of_hfov
from depthcli.errors import InputError
from depthcli.io.depth.read import read_metadata, read_stored_depth
from depthcli.io.exr.image import read_exr_rate
from depthcli.io.formats.table import WriterOptions
from depthcli.jobs.convert import ConvertRequest, ConvertResult, convert

ELSEWHERE: Box = (300, 300, 309, 309)
WINDOWS = pytest.mark.parametrize("data", [OVERSCAN, CROP, MIXED, DISPLAY, ELSEWHERE])


def write_depth_exr(path: Path, data: Box, channel: str = "Z") -> np.ndarray:
    """A depth EXR of another program; its depth grows downwards."""
    height, width = size_of(data)
    values = np.linspace(1, 9, height * width, dtype=np.float32).reshape(height, width)
    header = {
        "type": OpenEXR.scanlineimage,
        "dataWindow": (data[:2], data[2:]),
        "displayWindow": (DISPLAY[:2], DISPLAY[2:]),
        "pixelAspectRatio": 2.0,
        "framesPerSecond": Fraction(24000, 1001),
    }
    OpenEXR.File(header, {channel: values}).write(str(path))
    return values


def converted(source: Path, target: str, **more: object) -> ConvertResult:
    options = WriterOptions(**more)  # type: ignore[arg-type]
    return convert(ConvertRequest(str(source), str(source.with_name(target)), writing=options))


@WINDOWS
@pytest.mark.parametrize("half", [False, True])
def test_windows_pixels_and_rate_are_kept(data: Box, half: bool, tmp_path: Path) -> None:
    values = write_depth_exr(tmp_path / "a.exr", data)
    done = converted(tmp_path / "a.exr", "b.exr", half=half)
    *found, stored = written(tmp_path / "b.exr")
    assert found == [data, DISPLAY, 2]
    np.testing.assert_array_equal(stored, values.astype(np.float16) if half else values)
    assert read_exr_rate(tmp_path / "b.exr") == Fraction(24000, 1001)
    assert (done.depth.height, done.depth.width) == size_of(DISPLAY)
    assert (done.round_trip.max_error == 0) is not half
    again = converted(tmp_path / "b.exr", "c.exr", half=half)
    assert (tmp_path / "c.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
    assert again.round_trip.max_error == 0


@WINDOWS
def test_other_formats_are_of_the_display_window(data: Box, tmp_path: Path) -> None:
    write_depth_exr(tmp_path / "a.exr", data)
    shown = read_stored_depth(tmp_path / "a.exr").displayed.values
    assert shown.shape == size_of(DISPLAY)
    if np.isnan(shown).all():
        with pytest.raises(InputError):
            converted(tmp_path / "a.exr", "b.npy")
        return
    converted(tmp_path / "a.exr", "b.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "b.npy"), shown)
    converted(tmp_path / "a.exr", "b.png")
    steps = cv2.imread(str(tmp_path / "b.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(steps, np.rint(np.nan_to_num(shown) * 1000))


def test_depth_lost_in_the_overscan_is_counted(tmp_path: Path) -> None:
    values = write_depth_exr(tmp_path / "a.exr", OVERSCAN)
    values[0, :5] = 1e6  # beyond half floats
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        file.channels()["Z"].pixels = values
        file.write(str(tmp_path / "b.exr"))
    done = converted(tmp_path / "b.exr", "c.exr", half=True)
    assert done.round_trip.lost == 5


def test_its_field_of_view_is_that_of_the_display_window(tmp_path: Path) -> None:
    write_depth_exr(tmp_path / "a.exr", OVERSCAN)
    camera = Intrinsics(hfov_deg=40)
    convert(ConvertRequest(f"{tmp_path}/a.exr", f"{tmp_path}/b.exr", camera=camera))
    facts = read_metadata(tmp_path / "b.exr")
    assert float(facts["focal_px"]) == pytest.approx(focal_px_of_hfov(40, 64), rel=1e-5)
