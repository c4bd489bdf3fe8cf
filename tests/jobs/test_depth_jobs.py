"""Jobs on depth files, EXRs and depth videos: converting, describing."""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest
from helpers.command_line import Cli
from helpers.plates import CROP, DISPLAY, MIXED, OVERSCAN, Box, size_of, write_plate, written
from helpers.videos import NTSC, damage_frames, encode, flat_frames, write_depth_video

from depthcli.core.options import DepthEncoding
from depthcli.core.types import DepthMap, Frame, Provenance, Window, Windows
from depthcli.errors import InputError, UsageError
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.exr.file import read_exr_rate
from depthcli.io.formats.exr import ExrWriter
from depthcli.io.formats.raster import FloatWriter, Png16Writer
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.io.stored.depth import DepthReadOptions
from depthcli.jobs.convert import ConvertRequest, ConvertResult, RoundTrip, convert, convert_video
from depthcli.jobs.inspect import depth_at, inspect_file, read_map
from depthcli.video.depth_video import DepthVideo
from depthcli.video.frames import Timing
from depthcli.video.outputs import DepthFrame, DepthVideoOutput

VALUES_M = np.array([[1.0004, 2, np.nan, 70]], np.float32)


@pytest.fixture
def depth_npy(tmp_path: Path) -> Path:
    path = tmp_path / "d.npy"
    FloatWriter().write(DepthMap(VALUES_M), path)
    return path


@pytest.mark.parametrize("name", ["d.npy", "d.exr"])
def test_zero_negative_and_infinite_metres_are_no_depth(name: str, tmp_path: Path) -> None:
    path, values_m = tmp_path / name, np.float32([[0, -1, np.inf, np.nan, 2, 3]])
    (FloatWriter() if name == "d.npy" else ExrWriter()).write(DepthMap(values_m), path)
    assert inspect_file(str(path)).items() >= {"valid": 2, "min": 2, "max": 3}.items()
    depth = read_map(path).displayed
    assert [depth_at(depth, x, 0).depth for x in range(6)] == [None, None, None, None, 2, 3]
    done = convert(ConvertRequest(str(path), str(tmp_path / "a.png")))
    assert (done.warnings, done.round_trip) == ((), RoundTrip(0, 0, 0))
    steps = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)
    assert steps.tolist() == [[0, 0, 0, 0, 2000, 3000]]
    for target in map(str, (tmp_path / "b.npy", tmp_path / "b.npz", tmp_path / "b.bin")):
        convert(ConvertRequest(str(path), target))
    stored_m = [np.nan] * 4 + [2, 3]  # stonefish_ros2#13, Marigold#78, openlayers#13669
    np.testing.assert_array_equal(np.load(tmp_path / "b.npy"), [stored_m])
    np.testing.assert_array_equal(np.load(tmp_path / "b.npz")["depth"], [stored_m])
    assert (tmp_path / "b.bin").read_bytes()[-24:] == np.float32([0, 0, 0, 0, 2, 3]).tobytes()


FRAMES_M = np.float32([[[1, 2, 3, np.nan]] * 2, [[np.nan] * 4] * 2, [[7, 0.5, 6, 5]] * 2])


@pytest.fixture
def depth_mkv(tmp_path: Path) -> Path:
    """Three frames of 4 x 2 pixels in centimetres, the second without depth."""
    path = tmp_path / "d.mkv"
    write_depth_video(path, FRAMES_M, scale=100)
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
        depth = read_map(depth_mkv, DepthReadOptions(scale, frame=number)).displayed
        np.testing.assert_allclose(depth.values, values * unit_m, rtol=1e-6)


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
        values = tuple(facts[name] for name in ("valid", "min", "median", "max"))
        assert values == pytest.approx((6, unit_m, 2 * unit_m, 3 * unit_m))
        found_m = read_map(path, DepthReadOptions(scale)).displayed.values
        np.testing.assert_allclose(found_m, FRAMES_M[0] * unit_m, rtol=1e-6)
    floats = read_map(depth_npy, DepthReadOptions(100)).displayed.values
    np.testing.assert_allclose(floats, VALUES_M / 100, rtol=1e-6)


def test_the_scale_of_a_file_says_who_states_it(tmp_path: Path, depth_npy: Path) -> None:
    stated, plain, range_only = (tmp_path / f"{name}.png" for name in ("own", "plain", "range"))
    Png16Writer(png_scale=256).write(DepthMap(FRAMES_M[0]), stated)
    Png16Writer(png_normalize=True).write(DepthMap(FRAMES_M[0]), range_only)
    cv2.imwrite(str(plain), np.full((2, 4), 1000, np.uint16))
    scales = {
        (path.name, option): (facts["scale"], facts["scale_source"])
        for path, option in [(stated, None), (plain, None), (plain, 5000), (range_only, None)]
        for facts in [inspect_file(str(path), DepthReadOptions(option))]
    }
    assert scales == {
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


START = (1, 0, 0, 28, 0, *(0,) * 13)
SIZE = (32, 48)


def write_frames(
    path: Path,
    places: Iterable[Fraction | int],
    rate: Fraction = NTSC,
    *,
    step: int | None = None,
    **image: Any,
) -> Path:
    """Frames at multiples of a frame's duration, numbered from 1001 by these or by a step.

    Row 0 has no depth, row 1 is 1 m and a millimetre more in each frame, and the others are random
    millimetres below 3 m.
    """
    noise = np.random.default_rng(0)
    places = list(places)
    timing = Timing(rate, Fraction(1, 30_000), rate, step)
    with DepthVideoOutput(path, timing, WriterOptions()) as output:
        for count, place in enumerate(places):
            pixels = np.zeros(SIZE, np.uint8)
            time_s = float(place / rate)
            number = 1001 + (round(place) if step is None else count * step)
            frame = Frame(
                pixels, index=number, timestamp_s=time_s, rate=rate, time_code=START, **image
            )
            steps = noise.integers(1, 3000, SIZE)
            steps[1] = 1000 + count
            values_m = (steps / 1000).astype(np.float32)
            values_m[0] = np.nan
            depth = DepthMap(values_m, provenance=Provenance("m", "0" * 64, focal_px=16.0))
            output.append(output.encode(DepthFrame(frame, depth, (0, 1))))
        output.finish()
    return path


def clock_of(path: str | Path) -> tuple[Fraction | None, tuple[int, ...]]:
    """Rate, and time code without flags."""
    frame = read_stored_depth(path).frame
    return frame.rate, (frame.time_code or ())[:4]


@pytest.mark.parametrize("workers", [0, 3])
def test_every_frame_becomes_a_file_with_its_number(tmp_path: Path, workers: int) -> None:
    source = write_frames(tmp_path / "d.mkv", (0, 1, 2, 5, 6))
    request = ConvertRequest(str(source), str(tmp_path / "out" / "d.%05d.exr"))
    done = list(convert_video(request, workers))
    numbers = (1001, 1002, 1003, 1006, 1007)
    assert [result.target for result in done] == [
        str(tmp_path / "out" / f"d.{number:05d}.exr") for number in numbers
    ]
    for count, (result, number) in enumerate(zip(done, numbers, strict=True)):
        assert (result.round_trip, result.warnings) == (RoundTrip(0, 0, 0), ())
        stored = read_stored_depth(result.target)
        metres = stored.displayed.values
        assert np.isnan(metres[0]).all()
        np.testing.assert_allclose(metres[1], 1 + count / 1000, atol=1e-6)
        assert stored.depth.provenance.focal_px == 16
        assert stored.depth.provenance.time_s == pytest.approx((number - 1001) / NTSC, abs=6e-4)
        assert clock_of(result.target) == (NTSC, (1, 0, *divmod(28 + number - 1001, 30)))


def test_frames_of_a_variable_rate_are_numbered_consecutively(tmp_path: Path) -> None:
    places = [Fraction(n, 10) for n in (0, 7, 22, 31, 38)]
    source = write_frames(tmp_path / "d.mkv", places, step=2)
    frames = [stored.frame for stored in DepthVideo(source).frames()]
    assert [frame.index for frame in frames] == [1001, 1003, 1005, 1007, 1009]
    # At 240 frames a second, milliseconds are a quarter of a frame.
    source = write_frames(tmp_path / "f.mkv", (0, 1, 3, 4), Fraction(240))
    frames = [stored.frame for stored in DepthVideo(source).frames()]
    assert [frame.index for frame in frames] == [1001, 1002, 1004, 1005]


def test_frames_before_a_damaged_one_are_written(tmp_path: Path) -> None:
    source = write_frames(tmp_path / "d.mkv", range(12))
    data = bytearray(source.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 20] = bytes(20)
    source.write_bytes(data)
    with pytest.raises(InputError):
        list(convert_video(ConvertRequest(str(source), str(tmp_path / "d.#.png")), 3))
    written = sorted(tmp_path.glob("d.*.png"))
    assert 3 < len(written) < 9
    assert written[0].name == "d.1001.png"
    last_m = read_stored_depth(written[-1]).displayed.values[1, 0]
    assert last_m == pytest.approx(1 + (len(written) - 1) / 1000)


@pytest.mark.parametrize(
    "words",
    [
        {"source": "d.png"},
        {"stated": DepthReadOptions(frame=1)},
        {"image": "a.jpg"},
        {"target": "a.#.mkv"},
    ],
)
def test_patterns_that_do_not_fit_are_refused(
    words: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_frames(tmp_path / "d.mkv", range(2))
    options = {"source": "d.mkv", "target": "a.#.exr"} | words
    with pytest.raises(UsageError):
        list(convert_video(ConvertRequest(**options), 0))
    assert [path.name for path in tmp_path.iterdir()] == ["d.mkv"]


def test_geometry_is_that_of_the_plates(tmp_path: Path) -> None:
    display = Window(100, -50, 100 + SIZE[1], -50 + SIZE[0])
    windows = Windows(display, display, display)
    source = write_frames(tmp_path / "d.mkv", range(2), pixel_aspect=1.5, windows=windows)
    list(convert_video(ConvertRequest(str(source), str(tmp_path / "d.#.exr")), 0))
    frame = read_stored_depth(tmp_path / "d.1002.exr").frame
    assert (frame.pixel_aspect, frame.windows) == (1.5, windows)
    facts: Any = inspect_file(str(tmp_path / "d.1002.exr"))["metadata"]
    assert (facts["displayWindow"], facts["pixelAspectRatio"]) == ("100,-50 to 147,-19", "1.5")
    assert (facts["framesPerSecond"], facts["timeCode"]) == ("30000/1001", "01:00:00:29")


@pytest.mark.parametrize(
    ("name", "every"),
    [
        ("in", ()),
        ("in", ("--every", "2")),
        ("in", ("--every", "0.1s")),
        ("clip.mkv", ()),
        ("clip.mkv", ("--every", "2")),
        ("clip.mkv", ("--every", "0.2s")),
        ("damaged.mkv", ()),
        ("damaged.mkv", ("--every", "2")),
        ("damaged.mkv", ("--every", "0.1s", "--start-number", "1001")),
    ],
)
def test_numbers_are_those_of_video(name: str, every: tuple[str, ...], inside: Cli) -> None:
    places = (1, 2, 3, 5, 6, 8, 9)
    for number in places:
        write_plate(inside.folder / "in", number, DISPLAY)
    encode(  # frames that are missing in a video are not counted
        *(inside.folder / "clip.mkv", flat_frames(range(7)), Fraction(25), "mpeg4", "yuv420p"),
        times_s=[place / 25 for place in places],
        timecode="01:00:00:20",
    )
    damaged = inside.folder / "damaged.mkv"
    noise = np.random.default_rng(0).integers(0, 65536, (12, 48, 64), dtype=np.uint16)
    frames = damaged, noise, Fraction(25), "ffv1", "gray16le"
    encode(*frames, options={"g": "1"}, timecode="01:00:00:20")
    damage_frames(damaged, 4, 7)
    words = ("--format", "mkv", "--format", "exr", "--out", "out/")
    assert inside("video", name, *words, *every).returncode == (name == "damaged.mkv")
    (mkv,) = (inside.folder / "out").glob("*.mkv")
    assert inside("convert", f"out/{mkv.name}", "again/d.%06d.exr").returncode == 0
    there = sorted((inside.folder / "out").glob("*.exr"))
    here = sorted((inside.folder / "again").glob("*.exr"))
    assert [path.name[-10:] for path in here] == [path.name[-10:] for path in there]
    for ours, theirs in zip(here, there, strict=True):
        # The plates' drop-frame codes at 24 frames a second cannot be counted.
        parts = slice(1) if name == "in" else slice(None)
        assert clock_of(ours)[parts] == clock_of(theirs)[parts]
        difference = (
            read_stored_depth(ours).displayed.values - read_stored_depth(theirs).displayed.values
        )
        assert np.abs(difference).max() < 0.001


def test_the_command_reports_all_frames(inside: Cli) -> None:
    write_frames(inside.folder / "d.mkv", range(3))
    words = ("convert", "d.mkv", "d.%d.png", "--png-scale", "100000", "--workers", "2")
    done = inside(*words, code=0)
    assert b"3 frames converted; round trip: max error 2.34 m" in done.stdout
    assert b"3 frames have warnings" in done.stderr
    assert done.stderr.count(b"\n") == 1
    assert sorted(path.name for path in inside.folder.glob("d.1*")) == [
        f"d.{number}.png" for number in (1001, 1002, 1003)
    ]
    done = inside("convert", "d.mkv", "d.%d.npy", "--json", "--quiet")
    assert done.stdout.count(b'"status": "ok", "output": "d.100') == 3


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
    options = WriterOptions(**more)
    return convert(ConvertRequest(str(source), str(source.with_name(target)), writing=options))


@WINDOWS
@pytest.mark.parametrize("half", [False, True])
def test_windows_pixels_and_rate_are_kept(data: Box, half: bool, tmp_path: Path) -> None:
    values = write_depth_exr(tmp_path / "a.exr", data)
    done = converted(tmp_path / "a.exr", "b.exr", half=half)
    *header, stored = written(tmp_path / "b.exr")
    assert header == [data, DISPLAY, 2]
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
    values = read_stored_depth(tmp_path / "a.exr").displayed.values
    assert values.shape == size_of(DISPLAY)
    if np.isnan(values).all():
        with pytest.raises(InputError):
            converted(tmp_path / "a.exr", "b.npy")
        return
    converted(tmp_path / "a.exr", "b.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "b.npy"), values)
    converted(tmp_path / "a.exr", "b.png")
    steps = cv2.imread(str(tmp_path / "b.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(steps, np.rint(np.nan_to_num(values) * 1000))


def test_depth_lost_in_the_overscan_is_counted(tmp_path: Path) -> None:
    values = write_depth_exr(tmp_path / "a.exr", OVERSCAN)
    values[0, :5] = 1e6  # beyond half floats
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        file.channels()["Z"].pixels = values
        file.write(str(tmp_path / "b.exr"))
    done = converted(tmp_path / "b.exr", "c.exr", half=True)
    assert done.round_trip.lost == 5
