"""Videos in and out: exact rates and times, spans, turned and cut files, millimetres kept."""

import os
import wave
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from helpers.videos import (
    NTSC,
    encode,
    flat_frames,
    header_first,
    shot,
    trimmed,
    write_depth_video,
    write_mp4,
    write_preview_video,
    write_video,
)

from depthcli import __version__
from depthcli.core.imageops import value_channel
from depthcli.core.types import DepthKind
from depthcli.errors import InputError, OutputError, UsageError
from depthcli.io.formats.preview import PreviewWriter
from depthcli.io.guard import is_own
from depthcli.io.stored.metadata import normalized
from depthcli.video.depth_video import DepthVideo
from depthcli.video.formats import PreviewCodec
from depthcli.video.frames import Point, Span, Timing, exact_rate, rate_text
from depthcli.video.outputs import PreviewVideoOutput
from depthcli.video.source import VideoSource, open_frames

RATES = [
    *(Fraction(n * 1000, 1001) for n in (24, 30, 60)),
    *(Fraction(25), Fraction(1, 60), Fraction(10000, 1001), Fraction(1001, 37)),
]


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


@pytest.mark.parametrize("rate", RATES, ids=rate_text)
def test_a_depth_video_has_the_exact_rate_and_times(rate: Fraction, tmp_path: Path) -> None:
    frames = 200
    write_depth_video(tmp_path / "a.mkv", [np.ones((16, 16), np.float32)] * frames, rate)
    capture = cv2.VideoCapture(str(tmp_path / "a.mkv"), cv2.CAP_FFMPEG)  # another program
    fps, times_ms = capture.get(cv2.CAP_PROP_FPS), []
    while capture.grab():
        times_ms.append(capture.get(cv2.CAP_PROP_POS_MSEC))
    assert exact_rate(fps) == rate
    assert DepthVideo(tmp_path / "a.mkv").rate == rate
    if rate == NTSC:
        assert fps == 30000 / 1001
    assert times_ms == pytest.approx([float(i * 1000 / rate) for i in range(frames)], abs=0.501)


def test_uneven_times_of_a_video_are_read(tmp_path: Path) -> None:
    times_s = [0, 0.033, 0.067, 0.2, 0.233, 1.5]
    write_mp4(tmp_path / "a.mp4", flat_frames(range(6)), times_s=times_s)
    with VideoSource(tmp_path / "a.mp4") as source:
        timestamps_s = [frame.timestamp_s for frame in source.frames()]
        with pytest.raises(UsageError):
            next(source.frames())
    assert timestamps_s == pytest.approx(times_s, abs=0.0012)


def test_depth_out_of_range_saturates_with_a_warning(tmp_path: Path) -> None:
    values = np.array([[70, np.inf, np.nan], [0, -3, 1e-5]], np.float32)
    (warning,) = write_depth_video(tmp_path / "a.mkv", [values] * 3)
    assert "3 pixels" in warning
    steps = next(DepthVideo(tmp_path / "a.mkv").steps())
    assert steps.tolist() == [[65535, 0, 0], [0, 0, 1]]


def test_depth_without_a_unit_is_normalized_and_says_so(tmp_path: Path) -> None:
    values = np.array([[0, 0.5, 1], [np.nan, 2, -1]], np.float32)
    (warning,) = write_depth_video(tmp_path / "a.mkv", [values], kind=DepthKind.INVERSE)
    assert "no unit" in warning
    video = DepthVideo(tmp_path / "a.mkv")
    assert (video.scale, video.kind) == (None, DepthKind.INVERSE)
    expected = [[0, 0.5, 1], [np.nan, 1, 0]]
    np.testing.assert_allclose(next(iter(video)).values, expected, atol=1e-5)
    assert normalized(values, np.isfinite(values), 3, 3).tolist() == [[1, 1, 1], [0, 1, 1]]


@pytest.mark.parametrize(("options", "count"), [({"x264-params": "tff=1"}, 1), ({}, 0)])
def test_interlaced_video_gives_a_warning(
    options: dict[str, str], count: int, tmp_path: Path
) -> None:
    frames = flat_frames(range(4))
    path = encode(tmp_path / "a.mkv", frames, Fraction(25), "libx264", "yuv420p", options=options)
    with VideoSource(path) as source:
        assert len(source.warnings) == count
        assert all("ffmpeg -i in.mov -vf yadif" in warning for warning in source.warnings)


def test_a_colour_video_is_no_depth(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.avi", flat_frames([1, 2]))
    with pytest.raises(InputError):
        DepthVideo(path)


def test_a_size_that_the_codec_does_not_take_is_one_line(tmp_path: Path) -> None:
    wide = np.zeros((2, 20_000), np.float32)
    with pytest.raises(OutputError):
        write_preview_video(tmp_path / "a.mp4", [wide])
    assert list(tmp_path.iterdir()) == []


ONE = 1 << 16
MATRICES = {  # a, b, c, d: x' = a x + c y, y' = b x + d y
    1: (ONE, 0, 0, ONE),
    2: (-ONE, 0, 0, ONE),
    3: (-ONE, 0, 0, -ONE),
    4: (ONE, 0, 0, -ONE),
    5: (0, ONE, ONE, 0),
    6: (0, ONE, -ONE, 0),
    7: (0, -ONE, -ONE, 0),
    8: (0, -ONE, ONE, 0),
}


@pytest.mark.parametrize("suffix", ["mp4", "mkv"])
@pytest.mark.parametrize("orientation", MATRICES)
def test_a_turned_or_mirrored_video_stands_as_players_show_it(
    orientation: int, suffix: str, tmp_path: Path
) -> None:
    frame = np.zeros((48, 64, 3), np.uint8)
    frame[:12, :16] = 255  # the corner that moves
    a, b, c, d = MATRICES[orientation]
    path = encode(
        *(tmp_path / f"a.{suffix}", [frame] * 3, NTSC, "mpeg4", "yuv420p"),
        matrix=(a, b, 0, c, d, 0, 0, 0, 1 << 30),
        options={"b": "4M"},
    )
    with VideoSource(path) as source:
        first = next(source.frames())
        assert (source.width, source.height) == (first.width, first.height)
    middle = np.array([[8 - 32, 6 - 24]]) @ np.array([[a, b], [c, d]]) / ONE
    x, y = (middle[0] + np.array([first.width, first.height]) / 2).astype(int)
    assert first.orientation == orientation
    assert (first.width, first.height) == ((64, 48) if orientation < 5 else (48, 64))
    assert first.pixels[y, x].min() > 200
    assert (first.pixels > 128).mean() == pytest.approx(1 / 16, abs=0.01)


@pytest.mark.parametrize(
    ("matrix", "orientation"), [(None, 1), *((MATRICES[i], i) for i in (3, 6, 8))]
)
def test_frames_with_facts_that_pyav_does_not_know_are_read(
    matrix: tuple[int, ...] | None, orientation: int, tmp_path: Path
) -> None:
    """FFmpeg 8 hands on the EXIF of TIFF and Motion JPEG."""
    turn = None if matrix is None else (*matrix[:2], 0, *matrix[2:], 0, 0, 0, 1 << 30)
    path = encode(tmp_path / "a.mov", flat_frames([9] * 2), NTSC, "tiff", "rgb24", matrix=turn)
    with VideoSource(path) as source:
        frame = next(source.frames())
    assert frame.orientation == orientation
    assert np.unique(frame.pixels).tolist() == [9]


def random_maps() -> list[np.ndarray[Any, Any]]:
    return list(np.random.default_rng(0).random((60, 48, 64), np.float32) + 1)


def write_mp4_header_first(path: Path) -> None:
    path.write_bytes(header_first(write_mp4(path, noise_frames(60)).read_bytes()))


@pytest.mark.parametrize(
    ("name", "write", "share"),
    [
        ("a.mkv", lambda path: write_depth_video(path, random_maps()), 1 / 2),
        ("a.avi", lambda path: write_video(path, flat_frames(range(0, 256, 3))), 2 / 3),
        ("a.mp4", write_mp4_header_first, 2 / 3),
    ],
)
def test_a_cut_video_gives_what_there_is_and_says_so(
    name: str, write: Callable[[Path], object], share: float, tmp_path: Path
) -> None:
    path = tmp_path / name
    write(path)
    path.write_bytes(path.read_bytes()[: round(path.stat().st_size * share)])
    with VideoSource(path) as source:
        frames = list(source.frames())
        assert 5 < len(frames) < 60
        assert f"after {len(frames)}" in source.problem
    with VideoSource(path) as source:
        assert len(list(source.frames(Span(end=Point(Fraction(4), in_frames=True))))) == 4
        assert source.problem is None
    if path.suffix == ".mkv":
        with pytest.raises(InputError):
            list(DepthVideo(path))


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
    assert f"{len(missing)} frames cannot be decoded" in source.problem


def test_a_trimmed_video_is_whole(tmp_path: Path) -> None:
    path = write_mp4(tmp_path / "a.mp4", noise_frames(60))
    path.write_bytes(trimmed(path.read_bytes(), 0.5, 0.5))
    with VideoSource(path) as source:
        assert source.frames_stated == 60
        assert len(list(source.frames())) == pytest.approx(15, abs=1)
        assert source.problem is None


def test_a_video_that_begins_late_has_the_frames_that_it_has(tmp_path: Path) -> None:
    times_s = [5 + i / 25 for i in range(12)]  # as ffmpeg -copyts leaves them; MKV states 5.48 s
    path = write_mp4(tmp_path / "late.mkv", flat_frames(range(12)), Fraction(25), times_s)
    span = Span(Point(Fraction(90)))
    with VideoSource(path) as source:
        assert list(source.frames(span)) == []
        assert source.numbers_stated == (0, 11)


def test_frames_without_a_time_get_one(tmp_path: Path) -> None:
    path = encode(tmp_path / "a.m2v", noise_frames(30), Fraction(25), "mpeg2video", "yuv420p")
    with VideoSource(path) as source:
        times_s = [frame.timestamp_s for frame in source.frames()]
    assert times_s == pytest.approx([i / 25 for i in range(30)])


def test_files_without_video_and_playlists_are_one_line(tmp_path: Path, capfd: Any) -> None:
    (tmp_path / "empty.mp4").touch()
    (tmp_path / "text.mp4").write_text("hello " * 100)
    secret = write_mp4(tmp_path / "secret.mp4", flat_frames(range(3)))
    (tmp_path / "list.mp4").write_text(f"#EXTM3U\n#EXTINF:9,\n{secret}\n")
    (tmp_path / "other.mkv").write_text(f"ffconcat version 1.0\nfile '{secret}'\n")
    with wave.open(str(tmp_path / "sound.wav"), "wb") as sound:
        sound.setparams((1, 2, 8000, 4000, "NONE", ""))
        sound.writeframes(bytes(8000))
    names = ("empty.mp4", "text.mp4", "list.mp4", "other.mkv", "sound.wav", "missing.mp4", ".")
    for name in (*names, "/proc/version"):  # which states no size without its end
        with pytest.raises(InputError) as caught:
            VideoSource(tmp_path / name)
        assert str(tmp_path / name) in str(caught.value)
        assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("pixel_format", "bits"), [("yuv420p10le", 10), ("yuv444p12le", 12), ("gbrp10le", 10)]
)
def test_ten_and_twelve_bits_reach_the_value_channel(
    pixel_format: str, bits: int, tmp_path: Path
) -> None:
    gray = np.linspace(0, 65535, 1024).astype(np.uint16)  # every level that the columns can show
    ramp = np.repeat(gray[None, :, None], 16, 0).repeat(3, 2)
    path = encode(tmp_path / "a.mkv", [ramp] * 2, NTSC, "ffv1", pixel_format, colours="itu709")
    with VideoSource(path) as source:
        pixels = next(source.frames()).pixels
    assert pixels.dtype == np.uint16
    value = value_channel(pixels)
    np.testing.assert_allclose(value, ramp[..., 0] / 65535, atol=1.01 / 2**bits)
    assert np.unique(value).size > 800  # 8 bits have 256, or 219 in limited range


@pytest.mark.parametrize("colours", ["itu601", "itu709"])
def test_colours_follow_the_files_own_matrix(colours: str, tmp_path: Path) -> None:
    frame = np.zeros((48, 64, 3), np.uint8)
    frame[:] = (200, 40, 90)
    path = encode(tmp_path / "a.mkv", [frame], NTSC, "ffv1", "yuv444p", colours=colours)
    with VideoSource(path) as source:
        colour = next(source.frames()).pixels[5, 5]
    np.testing.assert_allclose(colour, (200, 40, 90), atol=2)


def test_a_gap_in_matroska_is_noticed(tmp_path: Path) -> None:
    write_depth_video(tmp_path / "a.mkv", random_maps())
    data = bytearray((tmp_path / "a.mkv").read_bytes())
    middle, gap = len(data) // 2, len(data) // 12
    data[middle : middle + gap] = bytes(gap)
    (tmp_path / "a.mkv").write_bytes(data)
    with VideoSource(tmp_path / "a.mkv") as source:
        assert 40 < len(list(source.frames())) < 58
        assert source.problem is not None


@pytest.mark.parametrize(
    ("suffix", "codec", "pixel_format"),
    [
        ("mp4", PreviewCodec.H264, "yuv420p"),
        ("mp4", PreviewCodec.AV1, "yuv420p"),
        ("webm", PreviewCodec.VP9, "yuv420p"),
        ("mov", PreviewCodec.PRORES, "yuv422p10le"),
    ],
)
def test_previews_of_every_codec(
    suffix: str, codec: PreviewCodec, pixel_format: str, tmp_path: Path, capfd: Any
) -> None:
    values = np.linspace(1, 5, 64, dtype=np.float32)[None].repeat(49, 0)
    for name in "ab":
        path = tmp_path / f"{name}.{suffix}"
        with PreviewVideoOutput(path, Timing(NTSC), PreviewWriter(), codec=codec) as output:
            for i in range(12):
                output.append(output.encode(shot(values + i / 12, time_s=i * 1001 / 30000)))
            # SVT-AV1 takes real-time priority as root, which starves other processes.
            tasks = [int(task.name) for task in Path("/proc/self/task").glob("*")]
            assert {os.sched_getscheduler(task) for task in tasks} <= {os.SCHED_OTHER}
            output.finish()
    assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()
    assert capfd.readouterr() == ("", "")
    with av.open(str(path)) as container:
        metadata, stream = container.metadata, container.streams.video[0]
        context = stream.codec_context
        assert (context.codec.canonical_name, context.pix_fmt) == (codec.value, pixel_format)
        assert stream.average_rate == NTSC
    assert metadata.get("comment", metadata.get("COMMENT")) == f"written by depthcli {__version__}"
    assert is_own(path)
    with pytest.raises(InputError, match="written by depthcli"):
        open_frames(path)
    with VideoSource(path) as source:
        frames = list(source.frames())
        assert source.problem is None
    assert [f.timestamp_s for f in frames] == [float(i / NTSC) for i in range(12)]
    expected = PreviewWriter().render(shot(values).depth, None, (0.0, 1.0))
    preview = frames[0].pixels_8bit()
    assert preview.shape == (50, 64, 3)
    assert np.abs(preview[:49].astype(int) - expected).mean() < 8


def test_a_long_preview_can_be_played_while_it_is_loaded_and_is_recognized(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    write_preview_video(path, [np.ones((16, 16), np.float32)] * 3000)
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")
    assert data.index(b"written by depthcli") > 4096  # behind its tables
    assert is_own(path)
