"""Depth files looked into and converted by the jobs themselves."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.videos import NTSC

from depthcli.core.options import DepthEncoding
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import InputError, UsageError
from depthcli.io.depth.read import DepthReadOptions, read_stored_depth
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.formats.npy import NpyWriter
from depthcli.io.formats.png16 import Png16Writer
from depthcli.io.formats.table import Format
from depthcli.jobs.convert import ConvertRequest, RoundTrip, convert
from depthcli.jobs.inspect import depth_at, inspect_file, read_map
from depthcli.video.frames import Timing
from depthcli.video.outputs import DepthFrame, DepthVideoOutput

VALUES_M = np.array([[1.0004, 2, np.nan, 70]], np.float32)


@pytest.fixture
def depth_npy(tmp_path: Path) -> Path:
    path = tmp_path / "d.npy"
    NpyWriter().write(DepthMap(VALUES_M), path)
    return path


def test_inspect_file_returns_the_facts_of_a_map(depth_npy: Path) -> None:
    facts = inspect_file(str(depth_npy))
    assert facts.items() >= {"kind": "metric", "unit": "m", "width": 4, "height": 1}.items()
    assert facts.items() >= {"valid": 3, "min": VALUES_M[0, 0], "median": 2, "max": 70}.items()


def test_a_pixel_has_depth_or_none(depth_npy: Path) -> None:
    depth = read_map(depth_npy).displayed
    assert (depth_at(depth, 1, 0), depth_at(depth, 2, 0)) == (2, None)
    for x, y in ((4, 0), (0, 1)):
        with pytest.raises(UsageError):
            depth_at(depth, x, y)


@pytest.mark.parametrize("name", ["d.npy", "d.exr"])
def test_zero_negative_and_infinite_metres_are_no_depth(name: str, tmp_path: Path) -> None:
    path, values_m = tmp_path / name, np.float32([[0, -1, np.inf, np.nan, 2, 3]])
    (NpyWriter() if name == "d.npy" else ExrWriter()).write(DepthMap(values_m), path)
    facts = inspect_file(str(path))
    assert facts.items() >= {"valid": 2, "min": 2, "max": 3}.items()
    depth = read_map(path).displayed
    assert [depth_at(depth, x, 0) for x in range(6)] == [None, None, None, None, 2, 3]
    done = convert(ConvertRequest(str(path), str(tmp_path / "a.png")))
    assert (done.warnings, done.round_trip) == ((), RoundTrip(0, 0, 1))
    steps = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)
    assert steps.tolist() == [[0, 0, 0, 0, 2000, 3000]]


FRAMES_M = np.float32([[[1, 2, 3, np.nan]] * 2, [[np.nan] * 4] * 2, [[7, 0.5, 6, 5]] * 2])


@pytest.fixture
def depth_mkv(tmp_path: Path) -> Path:
    """Three frames of 4 x 2 pixels in centimetres, the second without depth."""
    path = tmp_path / "d.mkv"
    with DepthVideoOutput(path, Timing(NTSC), 100, None) as output:
        for number, values in enumerate(FRAMES_M):
            frame = Frame(np.zeros((2, 4), np.uint8), timestamp_s=float(number / NTSC))
            output.append(output.encode(DepthFrame(frame, DepthMap(values), (0, 1))))
        output.finish()
    return path


@pytest.mark.parametrize(("scale", "unit_m"), [(None, 1), (50, 2)])
def test_inspect_file_knows_videos(depth_mkv: Path, scale: float | None, unit_m: float) -> None:
    facts = inspect_file(str(depth_mkv), DepthReadOptions(scale))
    metadata: Any = facts.pop("metadata")
    assert metadata["scale"] == "100"
    assert facts == {
        "input": str(depth_mkv),
        "kind": "metric",
        "unit": "m",
        "scale": scale or 100,
        "scale_source": "option" if scale else "file",
        "width": 4,
        "height": 2,
        "frames": 3,
        "fps": "30000/1001",
        "valid": 6 + 8,
        "min": pytest.approx(0.5 * unit_m),
        "max": pytest.approx(7 * unit_m),
    }
    for number, values in enumerate(FRAMES_M):
        found = read_map(depth_mkv, DepthReadOptions(scale, frame=number)).displayed
        np.testing.assert_allclose(found.values, values * unit_m, rtol=1e-6)


def test_a_frame_belongs_to_a_video(depth_mkv: Path, depth_npy: Path) -> None:
    with pytest.raises(InputError):
        read_map(depth_mkv, DepthReadOptions(frame=3))
    with pytest.raises(UsageError):
        read_map(depth_mkv)
    with pytest.raises(UsageError):
        read_map(depth_npy.with_suffix(".png"), DepthReadOptions(frame=0))


def test_a_scale_is_of_integers_and_of_floats(tmp_path: Path, depth_npy: Path) -> None:
    path = tmp_path / "d.png"
    Png16Writer(png_scale=100).write(DepthMap(FRAMES_M[0]), path)
    for scale, unit_m in ((None, 1), (50, 2)):
        facts = inspect_file(str(path), DepthReadOptions(scale))
        found = tuple(facts[name] for name in ("valid", "min", "median", "max"))
        assert found == pytest.approx((6, unit_m, 2 * unit_m, 3 * unit_m))
        found_m = read_map(path, DepthReadOptions(scale)).displayed.values
        np.testing.assert_allclose(found_m, FRAMES_M[0] * unit_m, rtol=1e-6)
    floats = read_map(depth_npy, DepthReadOptions(100)).displayed.values
    np.testing.assert_allclose(floats, VALUES_M / 100, rtol=1e-6)


def test_the_scale_of_a_file_says_who_states_it(tmp_path: Path, depth_npy: Path) -> None:
    stated, plain, range_only = (tmp_path / f"{name}.png" for name in ("own", "plain", "range"))
    Png16Writer(png_scale=256).write(DepthMap(FRAMES_M[0]), stated)
    Png16Writer(png_normalize=True).write(DepthMap(FRAMES_M[0]), range_only)
    cv2.imwrite(str(plain), np.full((2, 4), 1000, np.uint16))
    found = {
        (path.name, option): (facts["scale"], facts["scale_source"])
        for path, option in [(stated, None), (plain, None), (plain, 5000), (range_only, None)]
        for facts in [inspect_file(str(path), DepthReadOptions(option))]
    }
    assert found == {
        ("own.png", None): (256, "file"),
        ("plain.png", None): (1000, "assumed"),
        ("plain.png", 5000): (5000, "option"),
        ("range.png", None): (None, None),
    }
    of_floats = inspect_file(str(depth_npy))
    assert (of_floats["scale"], of_floats["scale_source"]) == (1, "assumed")


@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.uint8, np.int64])
def test_integers_need_a_scale(tmp_path: Path, dtype: type[np.integer[Any]]) -> None:
    path, metres = tmp_path / "mm.npy", tmp_path / "m.npy"
    np.save(path, np.array([[100, 0], [25, 120]], dtype))
    with pytest.raises(InputError):
        inspect_file(str(path))
    convert(ConvertRequest(str(path), str(metres), stated=DepthReadOptions(100)))
    for stored in (read_map(path, DepthReadOptions(100)), read_map(metres)):
        np.testing.assert_array_equal(stored.depth.values, np.float32([[1, np.nan], [0.25, 1.2]]))
    # Without a unit, numbers are what they are.
    relative = read_stored_depth(path, DepthReadOptions(kind=DepthEncoding.RELATIVE)).displayed
    np.testing.assert_array_equal(relative.values, [[100, 0], [25, 120]])


def test_a_target_without_suffix_gets_the_format_s(depth_npy: Path) -> None:
    done = convert(ConvertRequest(str(depth_npy), str(depth_npy.with_name("x")), Format.EXR))
    assert done.target == str(depth_npy.with_name("x.depth.exr"))
    assert read_stored_depth(depth_npy.with_name("x.depth.exr")).displayed.width == done.depth.width


def test_target_suffix_of_another_format_is_refused(depth_npy: Path) -> None:
    with pytest.raises(UsageError):
        convert(ConvertRequest(str(depth_npy), "other.npy", Format.EXR))


def test_pixels_that_have_depth_no_longer_are_lost() -> None:
    here, there = np.float32([[1, 2, 3, np.nan]]), np.float32([[1, np.nan, 3.5, 4]])
    assert RoundTrip.of(DepthMap(here), DepthMap(there)) == RoundTrip(0.5, 0.25, 1)
