"""Times and time codes from sequences and videos to the outputs."""

import json
import re
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import OpenEXR
import pytest
from helpers.command_line import Cli
from helpers.plates import CROP, DISPLAY, time_code_of, write_plate
from helpers.requests import predict_request, video_request
from helpers.videos import NTSC, encode, flat_frames, with_sound
from hypothesis import given, strategies as st

from depthcli.inference.loading import SessionLoader
from depthcli.io.exr.file import read_exr_channels
from depthcli.io.formats.table import Format
from depthcli.io.images.read import read_image
from depthcli.jobs.batch.plan import plan_files
from depthcli.jobs.batch.run import Batch, BatchRequest
from depthcli.jobs.batch.tasks import BatchOptions
from depthcli.jobs.convert import ConvertRequest, convert
from depthcli.jobs.predict import predict
from depthcli.jobs.video.plan import VideoSettings
from depthcli.jobs.video.run import video
from depthcli.video.depth_video import DepthVideo
from depthcli.video.formats import VideoFormat
from depthcli.video.frames import Point, Span, time_code_after, time_code_text
from depthcli.video.source import VideoSource

FILM = Fraction(24)


def stated(path: Path) -> tuple[Fraction | None, tuple[int, ...] | None]:
    part = next(iter(read_exr_channels(path).values())).part
    return part.rate, part.time_code


def test_depth_of_a_plate(tmp_path: Path, loader: SessionLoader) -> None:
    plate = write_plate(tmp_path / "in", 7, CROP)
    list(predict(predict_request([plate], f"{tmp_path}/a.exr", (Format.EXR,), model=loader)))
    convert(ConvertRequest(f"{tmp_path}/a.exr", f"{tmp_path}/b.exr"))
    plan = plan_files([plate.name], "mine", str(plate.parent), str(tmp_path / "c"))
    list(Batch(BatchRequest(plan, BatchOptions((Format.EXR,)), loader)))
    for name in ("a.exr", "b.exr", "c/plate.7.depth.exr"):
        assert stated(tmp_path / name) == (FILM, time_code_of(7))


def test_depth_of_a_sequence(tmp_path: Path, loader: SessionLoader) -> None:
    for number in range(1, 5):
        write_plate(tmp_path / "in", number, DISPLAY)
    settings = VideoSettings(span=Span(every=Point(Fraction(2), in_frames=True)))
    pattern, out = f"{tmp_path}/in/plate.%d.exr", f"{tmp_path}/out.%d.exr"
    video(video_request(pattern, out, (VideoFormat.EXR,), model=loader, settings=settings))
    assert stated(tmp_path / "out.1.exr") == (FILM, time_code_of(1))
    assert stated(tmp_path / "out.3.exr") == (FILM, time_code_of(3))


def write_parts(path: Path, number: int) -> Path:
    """Three parts, of which the first alone states rate and time code, and the last is depth."""
    path.parent.mkdir(exist_ok=True)
    header = {"type": OpenEXR.scanlineimage}
    gray = np.full((16, 16), 0.5, np.float32)
    code = OpenEXR.TimeCode(*time_code_of(number))
    parts = [
        OpenEXR.Part({**header, "framesPerSecond": FILM, "timeCode": code}, {"A": gray}, "matte"),
        OpenEXR.Part(dict(header), dict.fromkeys("RGB", gray), "rgba"),
        OpenEXR.Part(dict(header), {"Z": gray}, "depth"),
    ]
    OpenEXR.File(parts).write(str(path))
    return path


def test_of_several_parts_the_first_may_state_them(tmp_path: Path, loader: SessionLoader) -> None:
    plate = write_parts(tmp_path / "in" / "p.7.exr", 7)
    list(predict(predict_request([plate], f"{tmp_path}/a.exr", (Format.EXR,), model=loader)))
    convert(ConvertRequest(str(plate), f"{tmp_path}/b.exr"))
    pattern, out = f"{tmp_path}/in/p.%d.exr", f"{tmp_path}/out.%d.exr"
    video(video_request(pattern, out, (VideoFormat.EXR,), model=loader))
    for name in ("a.exr", "b.exr", "out.7.exr"):
        assert stated(tmp_path / name) == (FILM, time_code_of(7))


def test_a_time_code_that_is_none_is_left_out(tmp_path: Path) -> None:
    plate = write_plate(tmp_path, 1, DISPLAY)
    name = b"timeCode\0timecode\0\x08\0\0\0"
    data = plate.read_bytes()
    start = data.index(name) + len(name)
    plate.write_bytes(data[:start] + b"\xff" * 4 + data[start + 4 :])  # hour 45
    assert read_image(plate).time_code is None
    plate.write_bytes(data.replace(b"timeCode\0", b"timecode\0"))
    assert read_image(plate).time_code is None
    plate.write_bytes(data)
    assert read_image(plate).time_code == time_code_of(1)


def write_coded(path: Path, timecode: str | None) -> None:
    encode(path, flat_frames(range(8)), NTSC, "mpeg4", "yuv420p", timecode=timecode)


def found_in(path: Path) -> set[str]:
    """The time codes that another program sees."""
    with av.open(str(path)) as video:
        tables = (video.metadata, *(stream.metadata for stream in video.streams))
        return {
            text for table in tables for key, text in table.items() if key.lower() == "timecode"
        }


def next_drop_frame(hours: int, minutes: int, seconds: int, frame: int) -> tuple[int, ...]:
    """One frame later in 30 frames a second: no 0 and 1 in a minute, except every tenth."""
    frame += 1
    seconds, frame = seconds + frame // 30, frame % 30
    minutes, seconds = minutes + seconds // 60, seconds % 60
    hours, minutes = (hours + minutes // 60) % 24, minutes % 60
    if not seconds and frame < 2 and minutes % 10:
        frame = 2
    return hours, minutes, seconds, frame


def shown(numbers: tuple[int, ...] | None, rate: Fraction = NTSC) -> str | None:
    return None if numbers is None else time_code_text(numbers, rate)


def parsed(text: str, rate: Fraction = NTSC) -> tuple[int, ...]:
    *words, frame = map(int, re.split(r"[:;]", text))
    pair, second = divmod(frame, 2) if rate > 30 else (frame, 0)
    return *words, pair, int(";" in text), 0, second, *(0,) * 11


@given(st.sampled_from([(0, 0, 58, 0), (9, 59, 30, 5), (23, 59, 59, 0)]), st.integers(0, 4000))
def test_drop_frame_time_codes_leave_out_two_numbers_a_minute(
    start: tuple[int, int, int, int], frames: int
) -> None:
    later: tuple[int, ...] = start
    for _ in range(frames):
        later = next_drop_frame(*later)
    further = (1, *(0,) * 13)
    assert time_code_after((*start, *further), frames, NTSC) == (*later, *further)


@pytest.mark.parametrize(
    ("start", "frames", "rate", "later"),
    [
        ("01:02:03:04", 0, Fraction(24), "01:02:03:04"),
        ("01:02:03:04", 24 * 60 + 21, Fraction(24000, 1001), "01:03:04:01"),
        ("23:59:59:24", 1, Fraction(25), "00:00:00:00"),
        ("00:00:59;59", 1, Fraction(60000, 1001), "00:01:00;04"),
        ("00:00:59:29", 1, NTSC, "00:01:00:00"),
        ("25:00:00:30", 0, Fraction(24), "01:00:01:06"),
        ("00:00:59;23", 1, Fraction(24), None),
        ("00:00:00:00", 0, Fraction(25, 2), None),
        ("00:00:00:00", 0, Fraction(1, 3), None),
        ("00:00:00:00", 0, Fraction(120), None),
    ],
)
def test_time_codes_of_the_next(start: str, frames: int, rate: Fraction, later: str | None) -> None:
    assert shown(time_code_after(parsed(start, rate), frames, rate), rate) == later


@pytest.mark.parametrize("name", ["a.mov", "a.mp4", "a.mkv"])
@pytest.mark.parametrize("start", ["01:02:03:04", "01:02:59;28"])
def test_outputs_have_the_time_code_of_the_first_frame(name: str, start: str, inside: Cli) -> None:
    write_coded(inside.folder / name, start)
    formats = ("mkv", "mp4", "mov", "webm", "exr")
    words = [word for format_ in formats for word in ("--format", format_)]
    for options, frames in (((), 0), (("--start", "3f"), 3), (("--start", "0.1"), 3)):
        later = shown(time_code_after(parsed(start), frames, NTSC))
        done = inside("video", name, *words, "--out", "x.mkv", "--sidecar", "--json", *options)
        assert json.loads(done.stdout)["time_code"] == later
        assert json.loads((inside.folder / "x.depth.json").read_text())["time_code"] == later
        for output in ("x.depth.mkv", "x.preview.mp4", "x.preview.mov", "x.preview.webm"):
            assert found_in(inside.folder / output) == {later}
    last = OpenEXR.File(str(inside.folder / "x.depth.000007.exr")).header()["timeCode"]
    after = time_code_after(parsed(start), 7, NTSC) or ()
    assert (last.hours, last.minutes, last.seconds, last.frame, last.dropFrame) == after[:5]


@pytest.mark.parametrize("rate", [Fraction(48), Fraction(50), Fraction(60000, 1001)])
def test_above_30_frames_a_second_exr_numbers_pairs(rate: Fraction, inside: Cli) -> None:
    last = round(rate) - 1
    start = f"10:00:00:{last - 2:02d}"
    path = inside.folder / "a.mov"
    encode(path, flat_frames(range(8)), rate, "mpeg4", "yuv420p", timecode=start)
    done = inside("video", "a.mov", "--out", "x.%d.exr", "--json")
    assert (done.returncode, json.loads(done.stdout)["time_code"]) == (0, start)
    codes = [OpenEXR.File(str(inside.folder / f"x.{n}.exr")).header()["timeCode"] for n in range(6)]
    expected = [(0, last - 2), (0, last - 1), (0, last), (1, 0), (1, 1), (1, 2)]
    assert [(code.seconds, 2 * code.frame + code.fieldPhase) for code in codes] == expected
    assert inside("video", "a.mov", "--out", "y.mkv", "--start", "2f").returncode == 0
    assert found_in(inside.folder / "y.mkv") == {f"10:00:00:{last}"}
    assert inside("convert", "y.mkv", "z.%d.exr").returncode == 0
    code = OpenEXR.File(str(inside.folder / "z.3.exr")).header()["timeCode"]
    assert (code.seconds, code.frame, code.fieldPhase) == (1, 0, 0)


def test_a_time_code_counts_the_frames_of_its_file(inside: Cli) -> None:
    write_coded(inside.folder / "a.mov", "01:02:03:04")
    words = ("--out", "x.mov", "--start", "2f", "--every", "2", "--json")
    assert json.loads(inside("video", "a.mov", *words).stdout)["time_code"] == "01:02:03:06"
    assert found_in(inside.folder / "x.mov") == set()


def test_a_video_of_plates_has_their_time_code(inside: Cli) -> None:
    for number in (1, 2, 3):
        write_plate(inside.folder / "in", number, DISPLAY)
    words = ("--fps", "29.97", "--start", "2f", "--out", "x.mkv", "--json")
    done = inside("video", "in", *words)
    code = json.loads(done.stdout)["time_code"]
    assert parsed(code)[:4] == time_code_of(2)[:4]
    assert found_in(inside.folder / "x.mkv") == {code}


def test_a_time_code_and_audio_are_kept_in_a_pipe(inside: Cli) -> None:
    with_sound(inside.folder / "a.mov", seconds=1, timecode="10:00:00:00")
    done = inside("video", "a.mov", "--out", "-", "--format", "mp4")
    (inside.folder / "x.mp4").write_bytes(done.stdout)
    assert found_in(inside.folder / "x.mp4") == {"10:00:00:00"}
    with av.open(str(inside.folder / "x.mp4")) as video:
        assert (len(video.streams.video), len(video.streams.audio)) == (1, 1)


@pytest.mark.parametrize("stated", [None, "soon"])
def test_without_a_time_code_there_is_none(stated: str | None, inside: Cli) -> None:
    write_coded(inside.folder / "a.mkv", stated)
    done = inside("video", "a.mkv", "--out", "x.mov", "--json")
    assert json.loads(done.stdout)["time_code"] is None
    assert found_in(inside.folder / "x.mov") == set()


NOISE = [np.random.default_rng(i).integers(0, 256, (48, 64, 3), np.uint8) for i in range(12)]
FAST_S = [i / 60 for i in range(24)]
UNEVEN_S = [0, 0.017, 0.05, 0.083, 0.15, 0.167, 0.2, 0.266]


def times_s(path: Path) -> list[float]:
    """Times of the frames of a video, in order."""
    with VideoSource(path) as source:
        return [frame.timestamp_s or 0.0 for frame in source.frames()]


@pytest.mark.parametrize("stated_s", [FAST_S, UNEVEN_S])
def test_frames_that_do_not_follow_the_stated_rate_keep_their_times(
    stated_s: list[float], tmp_path: Path, loader: SessionLoader
) -> None:
    # Matroska states 30 frames a second, as FFmpeg writes it for any stream.
    frames = flat_frames(range(10, 10 + len(stated_s)))
    clip = encode(tmp_path / "a.mkv", frames, Fraction(30), "mjpeg", "yuvj444p", times_s=stated_s)
    formats = (VideoFormat.MKV, VideoFormat.MP4, VideoFormat.WEBM, VideoFormat.NPY)
    out = tmp_path / "out"
    video(video_request(clip, f"{out}/", formats, sidecar=True, model=loader))
    sidecar = json.loads((out / "a.depth.json").read_text())
    assert list(sidecar["times_s"].values()) == pytest.approx(stated_s, abs=0.0011)
    assert not sidecar["constant_rate"]
    depth_s = [
        depth.provenance.time_s for depth in DepthVideo(out / "a.depth.mkv") if depth.provenance
    ]
    assert depth_s == pytest.approx(stated_s, abs=0.0016)
    for suffix in ("mp4", "webm"):
        assert times_s(out / f"a.preview.{suffix}") == pytest.approx(stated_s, abs=0.0016)


@pytest.mark.parametrize(
    ("codec", "options"),
    [("mjpeg", {}), ("mpeg4", {}), ("mpeg4", {"bf": "2"}), ("libx264", {"bf": "0"}), ("ffv1", {})],
)
def test_a_frame_dropped_by_avi_is_a_gap(
    codec: str, options: dict[str, str], tmp_path: Path
) -> None:
    numbers = [0, 1, 2, 3, 4, *range(6, 12)]
    pixels = "yuvj444p" if codec == "mjpeg" else "yuv420p"
    path = tmp_path / "a.avi"
    clip = encode(path, NOISE[:11], Fraction(25), codec, pixels, numbers=numbers, options=options)
    assert times_s(clip) == pytest.approx([number / 25 for number in numbers])


@pytest.mark.parametrize(
    ("name", "codec", "rate"),
    [
        ("h264", "libx264", NTSC),
        ("hevc", "libx265", NTSC),
        ("mpeg1video", "mpeg1video", NTSC),
        ("mpeg1video", "mpeg1video", Fraction(24)),
        ("mpeg2video", "mpeg2video", NTSC),
        ("m4v", "mpeg4", NTSC),
        ("dv", "dvvideo", NTSC),
    ],
)
def test_a_stream_without_a_container_has_the_rate_that_it_states(
    name: str, codec: str, rate: Fraction, tmp_path: Path
) -> None:
    is_dv = codec == "dvvideo"
    frames = [np.full((480, 720, 3) if is_dv else (48, 64, 3), 9 * i, np.uint8) for i in range(12)]
    pixel_format = "yuv411p" if is_dv else "yuv420p"
    options = {"x265-params": "log-level=none"} if codec == "libx265" else {}
    path = tmp_path / f"a.{name}"
    clip = encode(path, frames, rate, codec, pixel_format, options=options, container=name)
    with VideoSource(clip) as source:
        assert source.rate == rate
        assert not any("rate" in warning for warning in source.warnings)
        times = [frame.timestamp_s for frame in source.frames()]
    assert times == pytest.approx([float(i / rate) for i in range(12)], abs=1e-6)


def test_a_stream_without_a_container_may_state_no_rate(tmp_path: Path) -> None:
    clip = encode(tmp_path / "a.mjpeg", NOISE, NTSC, "mjpeg", "yuvj444p")
    with VideoSource(clip) as source:
        assert source.warnings == ("the file states no frame rate; 25 a second is assumed",)


@pytest.mark.parametrize("suffix", [".avi", ".mxf", ".mkv"])
def test_frames_stored_in_another_order_have_even_times(suffix: str, tmp_path: Path) -> None:
    frames = [np.roll(NOISE[0], i, 1) for i in range(25)]
    options = {"bf": "3", "b-adapt": "0"}
    clip = encode(tmp_path / f"a{suffix}", frames, NTSC, "libx264", "yuv420p", options=options)
    with av.open(str(clip)) as container:
        packets = [packet.dts for packet in container.demux(video=0)]
        assert len(packets) > 25
    assert times_s(clip) == pytest.approx([float(i / NTSC) for i in range(25)], abs=1e-3)
