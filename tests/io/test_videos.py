"""Videos in and out: exact rates and times, spans, turned and cut files, millimetres kept."""

from __future__ import annotations

import os
import zlib
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from videos import NTSC, flat_frames, header_first, trimmed, turned, write_mp4, write_video

from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.errors import InputError, OutputError
from depthcli.io.depth_videos import DepthVideo
from depthcli.io.ebml import content, element_at, elements
from depthcli.io.ffmpeg_log import silent_ffmpeg
from depthcli.io.frame_rate import exact_rate, rate_text
from depthcli.io.mkv_finish import finish_mkv, mkv_labels
from depthcli.io.sources.video import VideoSource
from depthcli.io.sources.video_span import Point, Span
from depthcli.io.video_end import is_cut
from depthcli.io.writers.preview import PreviewWriter
from depthcli.io.writers.video import Shot, depth_video, preview_video, within

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

RATES = [
    *(Fraction(n * 1000, 1001) for n in (24, 30, 60, 120)),
    *(Fraction(n) for n in (1, 15, 25, 30, 50)),
    *(Fraction(1, 2), Fraction(1, 60), Fraction(10000, 1001), Fraction(1001, 37)),
]
TURN = tuple(range(0, 256, 3))


def shot(values: np.ndarray[Any, Any], kind: DepthKind = DepthKind.METRIC) -> Shot:
    return Shot(Frame(np.zeros(values.shape, np.uint8)), DepthMap(values, kind), (0.0, 1.0))


def write_depth(
    path: Path,
    maps: Sequence[np.ndarray[Any, Any]],
    rate: Fraction = NTSC,
    scale: float = 1000.0,
    times_s: Sequence[float] | None = None,
    kind: DepthKind = DepthKind.METRIC,
) -> tuple[str, ...]:
    with depth_video(path, rate, scale, ()) as output:
        for values in maps:
            output.append(output.encode(shot(values, kind)))
        return output.finish(times_s or [float(i / rate) for i in range(len(maps))])


def seen_times_ms(path: Path) -> tuple[float, list[float]]:
    """Rate and times as another program sees them."""
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    fps, times = capture.get(cv2.CAP_PROP_FPS), []
    while capture.grab():
        times.append(capture.get(cv2.CAP_PROP_POS_MSEC))
    return fps, times


@given(st.sampled_from([1001, 1]), st.integers(1, 240))
def test_a_rate_is_found_from_its_double(below: int, base: int) -> None:
    rate = Fraction(base * (1000 if below == 1001 else 1), below)
    found = exact_rate(float(rate))
    assert found == rate


@pytest.mark.parametrize(
    ("fps", "rate"),
    [
        (29.97, NTSC),
        (23.976, Fraction(24000, 1001)),
        (23.98, Fraction(24000, 1001)),
        (59.94, Fraction(60000, 1001)),
        (19001 / 317, Fraction(60000, 1001)),
        (12.5, Fraction(25, 2)),
        (27000 / 901, Fraction(27000, 901)),
        (24.0, Fraction(24)),
    ],
)
def test_rates_that_containers_round_are_known(fps: float, rate: Fraction) -> None:
    assert exact_rate(fps) == rate


@pytest.mark.parametrize("fps", [0, -1, float("nan"), float("inf"), 90000])
def test_a_rate_that_says_nothing_is_none(fps: float) -> None:
    assert exact_rate(fps) is None


def test_a_rate_is_written_as_a_fraction() -> None:
    assert (rate_text(NTSC), rate_text(Fraction(25))) == ("30000/1001", "25/1")


@pytest.mark.parametrize("rate", RATES, ids=rate_text)
def test_a_depth_video_has_the_exact_rate_and_times(rate: Fraction, tmp_path: Path) -> None:
    frames = 200
    write_depth(tmp_path / "a.mkv", [np.ones((16, 16), np.float32)] * frames, rate)
    fps, times_ms = seen_times_ms(tmp_path / "a.mkv")
    assert exact_rate(fps) == rate
    assert DepthVideo(tmp_path / "a.mkv").rate == rate
    if rate == NTSC:
        assert fps == 30000 / 1001
    assert times_ms == pytest.approx([round(float(i * 1000 / rate)) for i in range(frames)])


@pytest.mark.parametrize("rate", RATES, ids=rate_text)
def test_a_preview_has_the_exact_rate_and_times(rate: Fraction, tmp_path: Path) -> None:
    with preview_video(tmp_path / "a.mp4", rate, PreviewWriter(), ()) as output:
        for _ in range(40):
            output.append(output.encode(shot(np.ones((16, 16), np.float32))))
        output.finish([float(i / rate) for i in range(40)])
    fps, times_ms = seen_times_ms(tmp_path / "a.mp4")
    assert fps == float(rate)
    assert times_ms == pytest.approx([float(i * 1000 / rate) for i in range(40)], abs=0.01)


def test_a_late_frame_of_a_long_video_is_still_in_place(tmp_path: Path) -> None:
    maps = [np.ones((2, 2), np.float32)] * 40_000
    write_depth(tmp_path / "a.mkv", maps)
    _, times_ms = seen_times_ms(tmp_path / "a.mkv")
    assert times_ms[-1] == pytest.approx(round(39_999 * 1001 / 30))


@pytest.mark.parametrize(
    "times_s",
    [
        [0, 0.04, 40, 40.04, 40.08, 120],  # pauses
        [i / 24 for i in range(48)] + [2 + 60 * i for i in range(48)],  # slower than the mean
        [2 * i for i in range(48)] + [96 + i / 60 for i in range(400)],  # ahead of the mean
        [0, 16_000],
    ],
)
@pytest.mark.parametrize("rate", [Fraction(25), Fraction(1, 3)])
def test_times_far_from_the_mean_rate_are_kept(
    tmp_path: Path, times_s: list[float], rate: Fraction
) -> None:
    maps = [np.full((16, 16), 1 + 0.001 * i, np.float32) for i in range(len(times_s))]
    write_depth(tmp_path / "a.mkv", maps, rate, times_s=times_s)
    wanted_ms = [round(time_s * 1000) for time_s in times_s]
    assert seen_times_ms(tmp_path / "a.mkv")[1] == pytest.approx(wanted_ms)
    steps = [int(frame[0, 0]) for frame in DepthVideo(tmp_path / "a.mkv").steps()]
    assert steps == [1000 + i for i in range(len(times_s))]


def test_uneven_times_are_kept(tmp_path: Path) -> None:
    times_s = [0, 0.033, 0.067, 0.2, 0.233, 1.5]
    maps = [np.ones((16, 16), np.float32)] * 6
    write_depth(tmp_path / "a.mkv", maps, times_s=times_s)
    assert seen_times_ms(tmp_path / "a.mkv")[1] == pytest.approx([t * 1000 for t in times_s])
    mean = Fraction(300_000, 91_001)  # takes more digits than nanoseconds a frame have
    write_depth(tmp_path / "b.mkv", maps, mean, times_s=times_s)
    assert DepthVideo(tmp_path / "b.mkv").rate == mean
    write_mp4(tmp_path / "a.mp4", flat_frames(range(6)), times_s=times_s)
    with VideoSource(tmp_path / "a.mp4") as source:
        found = [frame.timestamp_s for frame in source.frames()]
    assert found == pytest.approx(times_s, abs=0.0012)


@pytest.mark.parametrize("size", [(48, 64), (47, 63), (1, 1), (2, 3), (31, 16)])
def test_millimetres_come_back_frame_for_frame(size: tuple[int, int], tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    steps = rng.integers(0, 65536, (30, *size), dtype=np.uint16)
    maps = [np.where(s == 0, np.nan, s / 1000).astype(np.float32) for s in steps]
    write_depth(tmp_path / "a.mkv", maps)
    video = DepthVideo(tmp_path / "a.mkv")
    np.testing.assert_array_equal(list(video.steps()), steps)
    for depth, values in zip(video, maps, strict=True):
        np.testing.assert_array_equal(depth.values, values)
    assert (video.rate, video.scale, video.kind) == (NTSC, 1000, DepthKind.METRIC)
    assert video.labels["frame_rate"] == "30000/1001"
    assert video.labels["unit"] == "mm"


def test_another_scale_is_labelled_and_obeyed(tmp_path: Path) -> None:
    values = np.full((8, 8), 2.5, np.float32)
    write_depth(tmp_path / "a.mkv", [values], scale=256)
    assert next(DepthVideo(tmp_path / "a.mkv").steps())[0, 0] == 640
    assert next(iter(DepthVideo(tmp_path / "a.mkv"))).values[0, 0] == 2.5
    assert next(iter(DepthVideo(tmp_path / "a.mkv", scale=640))).values[0, 0] == 1


def test_depth_out_of_range_saturates_with_a_warning(tmp_path: Path) -> None:
    values = np.array([[70, np.inf, np.nan, 0, -3, 1e-5]], np.float32)
    (warning,) = write_depth(tmp_path / "a.mkv", [values] * 3)
    assert "6 pixels" in warning
    steps = next(DepthVideo(tmp_path / "a.mkv").steps())
    assert steps.tolist() == [[65535, 65535, 0, 0, 0, 1]]


def test_depth_without_a_unit_is_normalized_and_says_so(tmp_path: Path) -> None:
    values = np.array([[0, 0.5, 1, np.nan, 2, -1]], np.float32)
    (warning,) = write_depth(tmp_path / "a.mkv", [values], kind=DepthKind.INVERSE)
    assert "no unit" in warning
    video = DepthVideo(tmp_path / "a.mkv")
    assert (video.scale, video.kind) == (None, DepthKind.INVERSE)
    expected = [[0, 0.5, 1, np.nan, 1, 0]]
    np.testing.assert_allclose(next(iter(video)).values, expected, atol=1e-5)
    assert within(values, 3, 3).tolist() == [[1, 1, 1, 0, 1, 1]]


def test_a_colour_video_is_no_depth(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.avi", flat_frames([1, 2]))
    with pytest.raises(InputError, match="16-bit"):
        DepthVideo(path)
    assert mkv_labels(path) == {}


def test_frames_that_are_not_in_the_file_are_noticed(tmp_path: Path) -> None:
    write_depth(tmp_path / "a.mkv", [np.ones((16, 16), np.float32)] * 5)
    with pytest.raises(ValueError, match="5 of 6 frames"):
        finish_mkv(tmp_path / "a.mkv", NTSC, [i / 30 for i in range(6)], {})
    (tmp_path / "a.mkv").write_bytes((tmp_path / "a.mkv").read_bytes()[:-50])
    with pytest.raises(ValueError, match="whole"):
        finish_mkv(tmp_path / "a.mkv", NTSC, [i / 30 for i in range(5)], {})


def test_a_size_that_the_codec_does_not_take_is_one_line(tmp_path: Path) -> None:
    wide = np.zeros((2, 20_000), np.float32)
    with (
        pytest.raises(OutputError, match="--format png16"),
        preview_video(tmp_path / "a.mp4", NTSC, PreviewWriter(), ()) as output,
    ):
        output.append(output.encode(shot(wide)))
    assert list(tmp_path.iterdir()) == []


def test_checksums_and_names_in_the_file_follow_from_its_content(tmp_path: Path) -> None:
    maps = [np.full((16, 16), 1 + i / 100, np.float32) for i in range(300)]
    for name in "ab":
        write_depth(tmp_path / f"{name}.mkv", maps)
    assert (tmp_path / "a.mkv").read_bytes() == (tmp_path / "b.mkv").read_bytes()
    checked = set()
    with (tmp_path / "a.mkv").open("rb") as file:
        segment = element_at(file, element_at(file, 0).end)
        for part in elements(file, segment.start, segment.end):
            data = content(file, part)
            if data[:2] == b"\xbf\x84":  # a checksum, of what follows it
                assert int.from_bytes(data[2:6], "little") == zlib.crc32(data[6:])
                checked.add(part.id)
            if b"DURATION" in data:
                assert f"00:00:{300 * 1001 / 30000:.9f}".encode() in data
    assert {0x1549A966, 0x1654AE6B, 0x1F43B675} <= checked  # information, tracks, clusters


def read(path: Path, span: Span) -> tuple[list[int], list[float]]:
    with VideoSource(path) as source:
        frames = list(source.frames(span))
    for frame in frames:
        assert abs(int(frame.pixels[0, 0, 0]) - 3 * frame.index) <= 3
    return [f.index for f in frames], [f.timestamp_s or 0.0 for f in frames]


def seconds(value: str) -> Point:
    return Point(Fraction(value))


def number(value: int) -> Point:
    return Point(Fraction(value), in_frames=True)


SPANS = [
    (Span(), list(range(80))),
    (Span(number(10), number(20)), list(range(10, 20))),
    (Span(seconds("0.4"), seconds("0.8")), list(range(10, 20))),
    (Span(seconds("0.41"), seconds("0.81")), list(range(11, 21))),
    (Span(every=number(30)), [0, 30, 60]),
    (Span(number(5), None, number(30)), [5, 35, 65]),
    (Span(every=seconds("1")), [0, 25, 50, 75]),
    (Span(every=seconds("0.1")), [0, 3, 5, 8, 10, 13, 15, 18, 20, 23, 25, 28, 30, 33]),
    (Span(every=seconds("0.001")), list(range(80))),
    (Span(number(79), number(500)), [79]),
    (Span(number(80)), []),
]


@pytest.mark.parametrize(("span", "expected"), SPANS)
def test_a_span_picks_its_frames(span: Span, expected: list[int], tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.avi", flat_frames(range(0, 240, 3)))
    indices, times_s = read(path, span)
    assert indices[: len(expected)] == expected
    assert times_s[: len(expected)] == pytest.approx([i / 25 for i in expected])
    if span.every.value != Fraction("0.1"):
        assert len(indices) == len(expected)
    assert span.count(80, Fraction(25)) == pytest.approx(len(indices), abs=1)


def test_the_rate_of_a_span() -> None:
    assert Span().rate(NTSC) == NTSC
    assert Span(every=number(3)).rate(NTSC) == Fraction(10000, 1001)
    assert Span(every=seconds("0.5")).rate(NTSC) == 2
    assert Span(every=seconds("0.001")).rate(NTSC) == NTSC


def test_exact_times_of_an_ntsc_video(tmp_path: Path) -> None:
    path = write_mp4(tmp_path / "a.mp4", flat_frames([0] * 100))
    with VideoSource(path) as source:
        assert (source.rate, source.frames_stated) == (NTSC, 100)
        times_s = [frame.timestamp_s for frame in source.frames()]
    assert times_s == [float(Fraction(i * 1001, 30000)) for i in range(100)]


def test_a_turned_video_stands_upright(tmp_path: Path) -> None:
    frame = np.zeros((48, 64, 3), np.uint8)
    frame[:, :32] = 255
    path = write_mp4(tmp_path / "a.mp4", [frame] * 3)
    path.write_bytes(turned(path.read_bytes()))
    with VideoSource(path) as source:
        assert (source.width, source.height) == (48, 64)
        first = next(source.frames())
    assert first.pixels.shape == (64, 48, 3)
    assert first.orientation == 6
    assert first.pixels[4:28].min() > 200
    assert first.pixels[36:60].max() < 50


def test_colours_are_red_green_blue(tmp_path: Path) -> None:
    red = np.zeros((48, 64, 3), np.uint8)
    red[..., 0] = 255
    path = write_video(tmp_path / "a.avi", [red] * 2)
    with VideoSource(path) as source:
        assert next(source.frames()).pixels[20, 20].tolist() == pytest.approx([255, 0, 0], abs=6)


def cut_mkv(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    path = tmp_path / "a.mkv"
    write_depth(path, [rng.random((48, 64), np.float32) + 1 for _ in range(60)])
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path


def cut_avi(tmp_path: Path) -> Path:
    path = write_video(tmp_path / "a.avi", flat_frames(TURN))
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    return path


def cut_mp4(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 255, (48, 64, 3), dtype=np.uint8) for _ in range(60)]
    path = write_mp4(tmp_path / "a.mp4", frames)
    whole = header_first(path.read_bytes())
    path.write_bytes(whole)
    with VideoSource(path) as source:
        assert len(list(source.frames())) == 60
        assert source.problem is None
    path.write_bytes(whole[: len(whole) * 2 // 3])
    return path


@pytest.mark.parametrize("make", [cut_mkv, cut_avi, cut_mp4])
def test_a_cut_video_gives_what_there_is_and_says_so(make: Any, tmp_path: Path) -> None:
    path = make(tmp_path)
    assert is_cut(path)
    with VideoSource(path) as source:
        frames = list(source.frames())
        assert 5 < len(frames) < 60
        assert source.problem is not None
        assert f"after {len(frames)}" in source.problem
    with VideoSource(path) as source:
        assert len(list(source.frames(Span(end=number(4))))) == 4
        assert source.problem is None


def test_a_whole_video_has_no_problem(tmp_path: Path) -> None:
    write_depth(tmp_path / "a.mkv", [np.ones((48, 64), np.float32)] * 20)
    write_mp4(tmp_path / "a.mp4", flat_frames(range(20)))
    write_video(tmp_path / "a.avi", flat_frames(range(20)))
    for path in tmp_path.iterdir():
        assert not is_cut(path)
        with VideoSource(path) as source:
            assert len(list(source.frames())) == 20
            assert source.problem is None


def noise_frames(count: int) -> list[np.ndarray[Any, Any]]:
    rng = np.random.default_rng(0)
    return [rng.integers(0, 255, (48, 64, 3), dtype=np.uint8) for _ in range(count)]


@pytest.mark.parametrize("place", [0.0, 0.5])
def test_a_damaged_place_costs_its_frames_and_not_the_rest(tmp_path: Path, place: float) -> None:
    path = write_mp4(tmp_path / "a.mp4", noise_frames(60))
    data = bytearray(path.read_bytes())
    start = data.index(b"mdat") + 4 + round(place * len(data))
    data[start : start + len(data) // 12] = bytes(len(data) // 12)
    path.write_bytes(data)
    with VideoSource(path) as source:
        frames = list(source.frames())
    missing = set(range(60)) - {frame.index for frame in frames}
    assert missing
    assert (min(missing) == 0) == (place == 0)
    assert frames[-1].index == 59
    assert max(missing) < 50
    times_s = [float(frame.index / NTSC) for frame in frames]
    assert [frame.timestamp_s for frame in frames] == pytest.approx(times_s, abs=0.002)
    assert source.problem is not None
    assert f"{len(missing)} frames cannot be decoded" in source.problem


def test_a_trimmed_video_is_whole(tmp_path: Path) -> None:
    path = write_mp4(tmp_path / "a.mp4", noise_frames(60))
    path.write_bytes(trimmed(path.read_bytes(), 0.5, 0.5))
    with VideoSource(path) as source:
        assert source.frames_stated == 60
        assert len(list(source.frames())) == pytest.approx(15, abs=1)
        assert source.problem is None


def test_a_video_with_few_frames_for_its_length_is_whole(tmp_path: Path) -> None:
    times_s = [i / 5 for i in range(30)]
    write_depth(tmp_path / "a.mkv", [np.ones((16, 16), np.float32)] * 30, times_s=times_s)
    with VideoSource(tmp_path / "a.mkv") as source:
        assert (source.frames_stated or 0) > 60  # OpenCV multiplies length and rate
        assert [frame.timestamp_s for frame in source.frames()] == pytest.approx(times_s)
        assert source.problem is None


def test_frames_without_a_time_get_one(tmp_path: Path) -> None:
    with silent_ffmpeg():
        code = cv2.VideoWriter.fourcc(*"mpg2")
        writer = cv2.VideoWriter(str(tmp_path / "a.mpg"), cv2.CAP_FFMPEG, code, 25, (64, 48))
    for frame in noise_frames(30):
        writer.write(frame)
    writer.release()
    assert 0 in seen_times_ms(tmp_path / "a.mpg")[1][1:]
    with VideoSource(tmp_path / "a.mpg") as source:
        times_s = [frame.timestamp_s for frame in source.frames()]
    assert times_s == pytest.approx([i / 25 for i in range(30)])


def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.mp4")
    with pytest.raises(InputError, match="to a file first"):
        VideoSource(tmp_path / "a.mp4")


def test_what_is_no_video_is_one_clear_line(tmp_path: Path, capfd: Any) -> None:
    (tmp_path / "empty.mp4").touch()
    (tmp_path / "text.mp4").write_text("hello " * 100)
    samples = bytes(8000)
    head = b"RIFF" + (36 + len(samples)).to_bytes(4, "little") + b"WAVEfmt " + bytes([16, 0, 0, 0])
    head += bytes([1, 0, 1, 0, 0x40, 0x1F, 0, 0, 0x40, 0x1F, 0, 0, 1, 0, 8, 0])
    sound = head + b"data" + len(samples).to_bytes(4, "little") + samples
    (tmp_path / "sound.wav").write_bytes(sound)
    (tmp_path / "link.mp4").symlink_to("nowhere")
    cases = {
        "empty.mp4": "is empty",
        "text.mp4": "no video",
        "sound.wav": "without a video stream",
        "missing.mp4": "no such file",
        "link.mp4": "broken link",
        ".": "folder",
    }
    for name, reason in cases.items():
        with pytest.raises(InputError, match=reason) as caught:
            VideoSource(tmp_path / name)
        assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


def test_frames_that_are_too_large_are_refused(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.avi", flat_frames([1]))
    with pytest.raises(InputError, match="--max-pixels"):
        VideoSource(path, max_pixels=64 * 48 - 1)
