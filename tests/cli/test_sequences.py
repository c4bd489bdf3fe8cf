"""Image sequences: patterns and folders."""

import json
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import OpenEXR
import pytest
from helpers.command_line import Cli
from helpers.folders import printed
from helpers.plates import OVERSCAN, write_plate
from helpers.videos import encode, flat_frames
from PIL import Image

from depthcli.core.options import Eye, ReadOptions
from depthcli.errors import UsageError
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.exr.file import read_exr_rate
from depthcli.video.depth_video import DepthVideo
from depthcli.video.frames import Point, Span
from depthcli.video.numbering import find_images, is_sequence, number_in, numbered_name
from depthcli.video.source import open_frames

FILM = Fraction(24000, 1001)


def write_exr(path: Path, level: float, rate: Fraction | None = None, aspect: float = 1) -> None:
    """Linear light, brighter to the right."""
    ramp = np.linspace(0, level, 64, dtype=np.float32)[None].repeat(48, 0)
    header: dict[str, Any] = {"type": OpenEXR.scanlineimage, "pixelAspectRatio": float(aspect)}
    if rate:
        header["framesPerSecond"] = rate
    OpenEXR.File(header, dict.fromkeys("RGB", ramp)).write(str(path))


def plates(folder: Path, numbers: range, rate: Fraction | None = FILM) -> str:
    folder.mkdir(exist_ok=True)
    for number in numbers:
        write_exr(folder / f"plate.{number:04d}.exr", 0.1 + (number % 10) / 20, rate)
    return f"{folder.name}/plate.%04d.exr"


@pytest.mark.parametrize(
    ("pattern", "name", "number"),
    [
        ("p.%04d.exr", "p.1001.exr", 1001),
        ("p.####.exr", "p.1001.exr", 1001),
        ("p.####.exr", "p.101.exr", None),
        ("p.%04d.exr", "p.12345.exr", 12345),
        ("p.#.exr", "p.1001.exr", 1001),
        ("take #2.%03d.exr", "take #2.007.exr", 7),
        ("a%d.%06d.png", "a%d.000012.png", 12),
        ("p.%d.exr", "p.7.exr", 7),
        ("%06d.png", "000012.png", 12),
        ("p.%04d.exr", "p.001.exr", None),
        ("p.%d.exr", "p.007.exr", None),
        ("p.%04d.exr", "q.1001.exr", None),
        ("p.%04d.exr", "p.10a1.exr", None),
        ("p.png", "p.png", None),
    ],
)
def test_patterns_name_numbers(pattern: str, name: str, number: int | None) -> None:
    assert number_in(pattern, name) == number
    if number is not None:
        assert numbered_name(pattern, number) == name


def test_a_percent_sign_in_the_name_of_a_file_is_no_pattern(tmp_path: Path) -> None:
    (tmp_path / "a%d.mp4").touch()
    assert not is_sequence(tmp_path / "a%d.mp4")
    assert is_sequence(tmp_path / "b%d.png")
    (tmp_path / "take##2.mp4").touch()
    assert not is_sequence(tmp_path / "take##2.mp4")
    assert not is_sequence(tmp_path / "take#3.mp4")


def test_without_a_stated_rate_there_are_25_frames_a_second_and_a_warning(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.1.exr", 2.0)
    with open_frames(tmp_path / "a.%d.exr") as source:
        assert (source.rate, len(source.warnings)) == (25, 1)


def test_sixteen_bit_images_keep_their_bits(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 65536, (8, 9, 3), dtype=np.uint16) for _ in range(3)]
    for number, pixels in enumerate(images, start=9):
        cv2.imwrite(str(tmp_path / f"{number:04d}.png"), pixels)
    with open_frames(tmp_path, rate=FILM) as source:
        frames = list(source.frames())
    assert [frame.index for frame in frames] == [9, 10, 11]
    assert [frame.timestamp_s for frame in frames] == [float(i / FILM) for i in range(3)]
    for frame, pixels in zip(frames, images, strict=True):
        np.testing.assert_array_equal(frame.pixels, pixels[..., ::-1])


def test_one_eye_of_stereo_images_is_read(tmp_path: Path) -> None:
    views = [Image.new("RGB", (16, 8), (level,) * 3) for level in (40, 200)]
    image = tmp_path / "1.jpg"
    views[0].save(image, "MPO", save_all=True, append_images=views[1:])
    data = image.read_bytes()
    at = data.index(b"MPF\0") + 54  # of the kind, which Pillow does not state
    image.write_bytes(data[:at] + b"\x02\x00\x02\x00" + data[at + 4 :])
    with open_frames(tmp_path, options=ReadOptions(eye=Eye.RIGHT)) as source:
        assert np.unique(next(source.frames()).pixels).tolist() == [200]


def test_a_span_counts_in_the_sequences_own_numbers(tmp_path: Path) -> None:
    plates(tmp_path, range(1001, 1011))
    span = Span(Point(Fraction(1003), in_frames=True), Point(Fraction(1008), in_frames=True))
    with open_frames(tmp_path / "plate.%04d.exr") as source:
        assert source.rate == FILM
        assert [frame.index for frame in source.frames(span)] == [1003, 1004, 1005, 1006, 1007]
        assert source.count(span) == 5


@pytest.mark.parametrize("start", ["1003", "1008f"])
def test_a_span_without_frames_names_the_numbers_that_there_are(start: str, inside: Cli) -> None:
    plates(inside.folder / "shot", range(1001, 1007))
    done = inside("video", "shot", "--start", start, "--out", "d.mkv", code=1)
    assert "1001–1006" in done.stderr.decode()


@pytest.mark.parametrize(
    ("every", "expected"),
    [
        (Point(Fraction(2), in_frames=True), [1001, 1003, 1005, 1009]),
        (Point(Fraction(2, 24)), [1001, 1003, 1005, 1008, 1009]),
    ],
)
def test_steps_count_numbers_where_some_are_missing(
    every: Point, expected: list[int], tmp_path: Path
) -> None:
    plates(tmp_path, range(1001, 1011), Fraction(24))
    for number in (1006, 1007):
        (tmp_path / f"plate.{number}.exr").unlink()
    span = Span(every=every)
    with open_frames(tmp_path / "plate.%04d.exr") as source:
        assert [frame.index for frame in source.frames(span)] == expected
        assert source.count(span) == len(expected)


def test_a_frame_that_a_live_stream_dropped_is_replaced_by_the_next() -> None:
    arrived = ((n, Fraction(n, 25), None) for n in (0, 1, 3, 5, 6, 7, 9))  # others dropped
    span = Span(every=Point(Fraction(2), in_frames=True))
    assert [number for number, *_ in span.select(arrived, is_live=True)] == [0, 3, 5, 6, 9]


EUROC = "1403636579763555584 1403636579813555456 1403636579863555584"  # MH_01_easy, cam0
TUM = "1305031102.175304 1305031102.211214 1305031102.243211"  # fr1/desk, within a second
BAG = "1700000000_983333333 1700000001_16666666 1700000001_116666665"  # {sec}_{nanosec} of ROS 2
MILLISECONDS = "1700000000123 1700000000156 1700000000190"  # of apps for Android, in Java
MVS = "Image_20260120191532433 Image_20260120191532466"  # Hikrobot's viewer: to milliseconds


@pytest.mark.parametrize(
    ("names", "numbers", "warnings"),
    [
        (EUROC, [0, 1, 2], 1),
        (TUM, [0, 1, 2], 1),
        (BAG, [0, 1, 2], 1),
        (BAG.replace("_", "."), [0, 1, 2], 1),
        ("1700000000_12 1700000000_13", [12, 13], 0),
        ("shot.1234567890.0001 shot.1234567890.0002", [1, 2], 0),
        (MILLISECONDS, [0, 1, 2], 1),
        (MVS, [0, 1], 1),
        ("2024011500001 2024011500002", [2024011500001, 2024011500002], 0),  # a date and a number
        ("1001 1002 90000", [1001, 1002, 90000], 1),  # which has a gap
        ("1001 2101 9001", [1001, 2101, 9001], 1),
        ("1403636579763555584", [1403636579763555584], 0),
    ],
)
def test_time_stamps_are_no_frame_numbers(
    names: str, numbers: list[int], warnings: int, tmp_path: Path
) -> None:
    for name in names.split():
        cv2.imwrite(f"{tmp_path}/{name}.png", np.zeros((8, 8), np.uint8))
    with open_frames(tmp_path, rate=Fraction(20)) as source:
        assert len(source.warnings) == warnings
        frames = list(source.frames())
    assert [frame.index for frame in frames] == numbers
    assert [frame.path and frame.path.stem for frame in frames] == names.split()
    assert [frame.timestamp_s for frame in frames] == [(n - numbers[0]) / 20 for n in numbers]


def test_plates_become_a_depth_video_and_depth_plates(inside: Cli) -> None:
    pattern = plates(inside.folder / "shot", range(1001, 1007))
    done = inside("video", pattern, "--out", "d.mkv", "--json")
    assert (done.returncode, done.stderr) == (0, b"")
    (facts,) = printed(done)
    assert (facts["frames"], facts["fps"]) == (6, "24000/1001")
    video = DepthVideo(inside.folder / "d.mkv")
    assert video.rate == FILM
    steps = list(video.steps())
    assert not inside("video", pattern, "--out", "out/depth.%04d.exr", "--json", code=0).stderr
    names = sorted(path.name for path in (inside.folder / "out").iterdir())
    assert names == [f"depth.{number}.exr" for number in range(1001, 1007)]
    for name, expected in zip(names, steps, strict=True):
        metres = read_stored_depth(inside.folder / "out" / name).displayed.values
        np.testing.assert_array_equal(np.rint(metres * 1000), expected)
        assert read_exr_rate(inside.folder / "out" / name) == FILM


def test_missing_and_damaged_plates_are_named_by_their_numbers(tmp_path: Path) -> None:
    pattern = plates(tmp_path / "shot", range(1001, 1012))
    for number in (1004, 1005, 1006, 1010):
        (tmp_path / "shot" / f"plate.{number}.exr").unlink()
    for number in (1002, 1007, 1008, 1009):
        (tmp_path / "shot" / f"plate.{number}.exr").write_bytes(b"v/1\x01 no more")
    with open_frames(tmp_path / pattern) as source:
        warning = "missing frames: 1004–1006, 1010; the other frames keep their times"
        assert source.warnings == (warning,)
        assert [frame.index for frame in source.frames()] == [1001, 1003, 1011]
        bad = "4 of its images cannot be read (1002, 1007, 1008, 1009), the last of them"
        assert source.problem.startswith(f"{bad}: {tmp_path}/shot/plate.1009.exr is ")


@pytest.mark.parametrize("damage", [b"v/1\x01 no more", None])
def test_a_damaged_first_plate_costs_no_other(damage: bytes | None, inside: Cli) -> None:
    pattern = plates(inside.folder / "shot", range(1001, 1005))
    first = inside.folder / "shot" / "plate.1001.exr"
    first.write_bytes(first.read_bytes()[:-500] if damage is None else damage)
    done = inside("video", pattern, "--out", "a.%d.png", "--json")
    (facts,) = printed(done)
    assert (done.returncode, facts["status"], facts["fps"]) == (1, "incomplete", "24000/1001")
    assert {path.name for path in inside.folder.glob("a.*")} == {f"a.100{n}.png" for n in (2, 3, 4)}
    assert not inside("video", pattern, "--start", "1002f", "--out", "b.%d.png", code=0).stderr
    for file in inside.folder.glob("a.*"):
        assert file.read_bytes() == (inside.folder / f"b{file.name[1:]}").read_bytes()


def test_plates_are_never_overwritten(inside: Cli) -> None:
    pattern = plates(inside.folder / "shot", range(1, 4))
    before = (inside.folder / "shot" / "plate.0001.exr").read_bytes()
    assert inside("video", pattern, "--out", pattern).returncode == 1
    (inside.folder / "link").symlink_to("shot")
    done = inside("video", pattern, "--out", "link/plate.%04d.exr", code=1)
    assert b"is an input" in done.stderr
    assert (inside.folder / "shot" / "plate.0001.exr").read_bytes() == before


def test_a_single_image_is_for_predict(inside: Cli) -> None:
    write_exr(inside.folder / "p.0001.exr", 1.0)
    done = inside("video", "p.0001.exr", code=1)
    assert b"p.0001.exr is a single image; use 'depthcli predict'" in done.stderr
    assert inside("video", "p.####.exr", "--fps", "24", "--out", "d.mkv").returncode == 0


def write_images(folder: Path, numbers: Iterable[int]) -> None:
    folder.mkdir()
    for number in numbers:
        pixels = np.full((16, 16, 3), number * 20, np.uint8)
        cv2.imwrite(str(folder / f"f{number}.png"), pixels)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ("f1 f10 f2 f4 f9", "1:f1 2:f2 4:f4 9:f9 10:f10"),
        ("f10_left f9_left", "9:f9_left 10:f10_left"),
        ("a3 b5 c20", "0:a3 1:b5 2:c20"),
        ("a b c2", "0:a 1:b 2:c2"),
        ("1.033333 1.066667 2.000000 2.033333", "0:1.033333 1:1.066667 2:2.000000 3:2.033333"),
        ("12-00-01 12-00-31 12-01-01", "0:12-00-01 1:12-00-31 2:12-01-01"),
        ("p.11.v003 p.12.v003 p.14.v003", "11:p.11.v003 12:p.12.v003 14:p.14.v003"),
        ("p10.v2 p9.v2 p9999.v2", "9:p9.v2 10:p10.v2 9999:p9999.v2"),
        ("p.1001.v003 p.1002.v004", "0:p.1001.v003 1:p.1002.v004"),
        ("p.1.v003 p.01.v003", "0:p.01.v003 1:p.1.v003"),
    ],
)
def test_the_order_and_numbers_of_a_folder(names: str, expected: str, tmp_path: Path) -> None:
    for name in names.split():
        (tmp_path / f"{name}.png").touch()
    images = find_images(tmp_path)
    assert " ".join(f"{file.number}:{file.path.stem}" for file in images) == expected


@pytest.mark.parametrize(
    ("names", "patterns"),
    [
        ("L.0998.png L.0999.png R.0998.png R.0999.png", "L.####.png R.####.png"),
        ("L.1.png L.3.png R.1.png R.3.png", "L.%d.png R.%d.png"),
        ("p.1001.png p.1002.png p.1001.jpg p.1002.jpg", "p.####.jpg p.####.png"),
        ("p.1001.png p.1005.png sheet.png", "p.####.png"),
        ("v1.1001.png v1.1002.png v2.1001.png v2.1002.png", "v1.####.png v2.####.png"),
        ("p.-1.png p.-2.png p.0.png p.1.png", "p.-%d.png p.%d.png"),
        ("f02.png f10.png f2.png", "f%d.png"),
        ("f9.png f10.png f11_left.png", "f%d.png"),
    ],
)
def test_a_folder_with_two_sequences_is_refused(names: str, patterns: str, tmp_path: Path) -> None:
    for name in names.split():
        (tmp_path / name).touch()
    with pytest.raises(UsageError, match="more than a single image sequence"):
        find_images(tmp_path)
    for pattern in patterns.split():
        assert find_images(tmp_path / pattern)


def test_outputs_in_a_folder_of_images_are_ignored_with_any_name(inside: Cli) -> None:
    write_images(inside.folder / "f", (1, 2, 10))
    assert inside("video", "f/f%d.png", "--out", "f/d%d.png").returncode == 0
    assert inside("video", "f/f%d.png", "--out", "f/z.%04d.exr").returncode == 0
    assert len(list((inside.folder / "f").iterdir())) == 9
    assert [file.number for file in find_images(inside.folder / "f")] == [1, 2, 10]
    assert json.loads(inside("video", "f/", "--out", "d.mkv", "--json").stdout)["frames"] == 3


@pytest.mark.parametrize("source", ["d/", "d/d.%04d.exr"])
def test_a_sequence_of_outputs_is_refused(source: str, inside: Cli) -> None:
    write_images(inside.folder / "f", (1, 2))
    assert inside("video", "f/", "--out", "d/d.%04d.exr").returncode == 0
    done = inside("video", source, "--out", "again.mkv", code=1)
    (line,) = done.stderr.decode().splitlines()
    assert "d/d.0001.exr" in line


def test_a_depth_video_is_no_video_to_estimate(inside: Cli) -> None:
    write_images(inside.folder / "f", (1, 2))
    assert inside("video", "f/", "--out", "any.mkv", "--fps", "24").returncode == 0
    for words, data in ((("any.mkv",), b""), (("-",), (inside.folder / "any.mkv").read_bytes())):
        done = inside("video", *words, "--out", "again.mkv", stdin=data, code=1)
        assert words[0] in done.stderr.decode() or data
    assert not (inside.folder / "again.mkv").exists()


def test_a_depth_sequence_becomes_what_its_plates_do(inside: Cli) -> None:
    for number in (1001, 1002, 1004, 1005):  # with overscan and time codes that cannot be counted
        write_plate(inside.folder / "shot", number, OVERSCAN)
    inside("video", "shot", "--out", "d/depth.%04d.exr", code=0)
    inside("video", "shot", "--out", "direct.mkv", code=0)
    inside("convert", "d/depth.####.exr", "again.mkv", code=0)
    assert (inside.folder / "again.mkv").read_bytes() == (inside.folder / "direct.mkv").read_bytes()
    fixed = ("--vmin", "0.5", "--vmax", "20")
    inside("convert", "d", "p/depth.%04d.png", "--png-inverse", *fixed, code=0)
    names = {f"depth.{number}.png" for number in (1001, 1002, 1004, 1005)}
    assert {path.name for path in (inside.folder / "p").iterdir()} == names
    for path in (inside.folder / "p").iterdir():
        depth_m = read_stored_depth(inside.folder / "d" / f"{path.stem}.exr").displayed.values
        share = (1 / depth_m - 1 / 20) / (1 / 0.5 - 1 / 20)
        steps = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        np.testing.assert_allclose(steps, 1 + share.clip(0, 1) * 65534, atol=1)
    done = inside("convert", "p", "p/depth.####.png", "--overwrite", code=2)
    assert b"is an input" in done.stderr


@pytest.mark.parametrize("step", [1, 2])
@pytest.mark.parametrize("source", ["d/depth.%04d.exr", "d.mkv"])
def test_a_preview_of_a_depth_sequence_has_its_times(source: str, step: int, inside: Cli) -> None:
    """Numbers count the frames of the shot, so that the rate is its rate, too."""
    pattern = plates(inside.folder / "shot", range(1001, 1008))
    inside("video", pattern, "--out", source, "--every", str(step), code=0)
    if source == "d.mkv":
        inside("convert", source, "d/depth.%04d.exr", code=0)
    assert read_exr_rate(inside.folder / f"d/depth.{1001 + step}.exr") == FILM
    inside("convert", source, "preview.mp4", "--vmin", "1", "--vmax", "2", code=0)
    with av.open(str(inside.folder / "preview.mp4")) as container:
        times_s = [frame.time for frame in container.decode(video=0)]
    assert times_s == pytest.approx([n / FILM for n in range(0, 7, step)])


@pytest.mark.parametrize("suffix", ["exr", "png"])
def test_numbered_files_of_a_phone_s_video_keep_its_times(suffix: str, inside: Cli) -> None:
    times_s = [0, 1 / 30, 0.08, 0.15, 0.4]
    frames = inside.folder / "v.mkv", flat_frames(range(5)), Fraction(30), "ffv1", "yuv420p"
    encode(*frames, times_s=times_s)
    inside("video", "v.mkv", "--out", f"d/%d.{suffix}", code=0)
    assert not inside("convert", f"d/%d.{suffix}", "d.mkv", code=0).stderr
    found_s = [frame.frame.timestamp_s for frame in DepthVideo(inside.folder / "d.mkv").frames()]
    assert found_s == pytest.approx(times_s, abs=1e-3)
    (inside.folder / f"d/0.{suffix}").rename(inside.folder / f"d/5.{suffix}")  # of another clip
    done = inside("convert", f"d/%d.{suffix}", "e.mkv", code=1)
    assert b"is not later than the frame before it; give --fps" in done.stderr
    inside("convert", f"d/%d.{suffix}", "e.mkv", "--fps", "25", code=0)


def test_numbered_files_without_a_rate_get_that_of_an_option(inside: Cli) -> None:
    (inside.folder / "d").mkdir()
    for number in (7, 9):
        np.save(inside.folder / "d" / f"f.{number}.npy", np.full((4, 6), number, np.float32))
    for words, rate, warned in (((), 25, True), (("--fps", "23.976"), FILM, False)):
        done = inside("convert", "d", "d.mkv", *words, code=0)
        video = DepthVideo(inside.folder / "d.mkv")
        assert (video.rate, b"25" in done.stderr) == (rate, warned)
        assert [int(frame.depth.values[0, 0]) for frame in video.frames()] == [7, 9]
        assert [frame.frame.index for frame in video.frames()] == [7, 9]
    np.save(inside.folder / "d" / "f.11.npy", np.ones((5, 6), np.float32))
    done = inside("convert", "d", "other.mkv", code=1)  # FFmpeg would resize the third
    assert b"f.11.npy has another size" in done.stderr
    assert not (inside.folder / "other.mkv").exists()


def test_numbered_files_and_a_preview_in_one_run(inside: Cli) -> None:
    pattern = plates(inside.folder / "shot", range(1001, 1004))
    formats = [f"--format={name}" for name in ("mp4", "exr", "normals")]
    inside("video", pattern, "-o", "d/depth.####.exr", *formats, "--sidecar", code=0)
    assert sorted(path.name for path in (inside.folder / "d").iterdir()) == [
        *(f"depth.{number}.exr" for number in range(1001, 1004)),
        "depth.json",
        *(f"depth.normals.{number}.png" for number in range(1001, 1004)),
        "depth.preview.mp4",
    ]
    inside("video", pattern, "-o", "d/depth.####.exr", "--format", "mp4", code=2)


def test_normals_are_not_those_of_rounded_depth(inside: Cli) -> None:
    """Of a plate of 2048 columns, millimetres turned them by 6° (median)."""
    pattern = plates(inside.folder / "shot", range(1001, 1003))
    inside("video", pattern, "--format", "normals", "-o", "alone/", code=0)
    inside("video", pattern, "--format", "mkv", "--format", "normals", "-o", "both/", code=0)
    for path in (inside.folder / "alone").iterdir():
        assert path.read_bytes() == (inside.folder / "both" / path.name).read_bytes()
