"""Times and numbers of frames, from any container to every output."""

import json
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from helpers.requests import video_request
from helpers.tiny import write_model, write_picture
from helpers.videos import NTSC, encode, flat_frames

from depthcli.inference.loading import SessionLoader
from depthcli.jobs.convert import ConvertRequest, convert_video
from depthcli.jobs.video.plan import VideoSettings
from depthcli.jobs.video.run import video
from depthcli.video.depth_video import DepthVideo
from depthcli.video.formats import VideoFormat
from depthcli.video.frames import Point, Span
from depthcli.video.source import VideoSource

NOISE = [np.random.default_rng(i).integers(0, 256, (48, 64, 3), np.uint8) for i in range(12)]
FAST_S = [i / 60 for i in range(24)]
UNEVEN_S = [0, 0.017, 0.05, 0.083, 0.15, 0.167, 0.2, 0.266]


@pytest.fixture
def loader(tmp_path: Path) -> SessionLoader:
    """Bright is far."""
    return SessionLoader(write_model(tmp_path / "model"), "cpu")


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
    [
        ("mjpeg", {}),
        ("mpeg4", {}),
        ("mpeg4", {"bf": "2"}),
        ("libx264", {"bf": "0"}),
        ("ffv1", {}),
    ],
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
        found = [frame.timestamp_s for frame in source.frames()]
    assert found == pytest.approx([float(i / rate) for i in range(12)], abs=1e-6)


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


def test_numbers_of_a_depth_video_are_those_of_files(tmp_path: Path, loader: SessionLoader) -> None:
    for number in range(1001, 1013):
        write_picture(tmp_path / "in" / f"p.{number}.png")
    uneven = encode(
        tmp_path / "v.mp4",
        flat_frames(range(40)),
        NTSC,
        "mpeg4",
        "yuv420p",
        times_s=[i / 30 + 0.004 * (i % 3) for i in range(40)],
    )
    sequence = str(tmp_path / "in" / "p.%04d.png")
    for source, fps, every in (
        (sequence, Fraction(1500), Point(Fraction(1), in_frames=True)),
        (sequence, Fraction(2500), Point(Fraction(3), in_frames=True)),
        (str(uneven), None, Point(Fraction(1, 20), in_frames=False)),
        (str(uneven), None, Point(Fraction(1, 10), in_frames=False)),
    ):
        out = tmp_path / f"{fps}-{every.value.denominator}-{every.value.numerator}"
        settings = VideoSettings(fps=fps, span=Span(every=every))
        formats = (VideoFormat.MKV, VideoFormat.NPY)
        done = video(video_request(source, f"{out}/", formats, model=loader, settings=settings))
        (depth,) = out.glob("*.mkv")
        list(convert_video(ConvertRequest(str(depth), str(out / "c.%06d.npy")), 2))
        converted = sorted(int(path.stem[-6:]) for path in out.glob("c.*.npy"))
        assert converted == list(done.numbers)
