"""Videos worked off by the job itself, as a program calls it."""

import dataclasses
import io
import itertools
import json
import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.file_trees import contents
from helpers.requests import video_request
from helpers.tiny import load, write_image, write_model
from helpers.videos import NTSC, encode, flat_frames, write_mp4, write_ramp, write_video
from helpers.watched import Watched

import depthcli
from depthcli._version import __version__
from depthcli.core.camera import Intrinsics
from depthcli.core.options import UpsamplingOptions
from depthcli.errors import InputError, OutputError, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.depth.read import read_metadata, read_stored_depth
from depthcli.io.formats.table import WriterOptions
from depthcli.io.stored.depth import DepthReadOptions
from depthcli.jobs.convert import ConvertRequest, convert
from depthcli.jobs.video.plan import (
    VideoRequest,
    VideoResult,
    VideoSettings,
    plan_video,
    video_destination,
)
from depthcli.jobs.video.run import video
from depthcli.video.depth_video import DepthVideo
from depthcli.video.formats import SEQUENCES, VIDEOS, PreviewCodec, VideoFormat
from depthcli.video.frames import Point, Span
from depthcli.video.numbering import numbered_name
from depthcli.video.source import VideoSource


@pytest.fixture
def clip(tmp_path: Path) -> Path:
    """24 frames that get brighter."""
    return write_ramp(tmp_path / "clip.mp4")


def run(path: Path, output: Path | str, loader: SessionLoader, **settings: Any) -> VideoResult:
    return video(video_request(path, output, model=loader, settings=VideoSettings(**settings)))


def frame_number(number: int) -> Point:
    return Point(Fraction(number), in_frames=True)


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize("smooth_s", [0.0, 0.2])
def test_the_sidecar_says_what_the_outputs_mean(
    clip: Path, tmp_path: Path, loader: SessionLoader, smooth_s: float
) -> None:
    span = Span(frame_number(4), every=frame_number(2))
    settings = VideoSettings(span=span, smooth_s=smooth_s, camera=Intrinsics(hfov_deg=60))
    write_model(tmp_path / "model", camera={"hfov_deg": 60.0})
    request = video_request(clip, f"{tmp_path}/out/", sidecar=True, model=loader, settings=settings)
    done = video(request)
    assert done.outputs == tuple(
        f"{tmp_path}/out/clip.{name}" for name in ("depth.mkv", "preview.mp4", "depth.json")
    )
    assert done.flicker is not None
    if smooth_s:
        assert 0 < done.flicker < (done.flicker_unsmoothed or 0)
    text = (tmp_path / "out" / "clip.depth.json").read_text()
    assert text.startswith('{\n  "software": ')
    assert text.endswith("\n}\n")
    assert json.loads(text) == {
        "software": f"depthcli {__version__}",
        "frames": 10,
        "fps": "15000/1001",
        "source_fps": "30000/1001",
        "constant_rate": True,
        "first_frame": 4,
        "start_s": pytest.approx(4 * 1001 / 30000),
        "time_code": None,
        "width": 64,
        "height": 48,
        "orientation": 1,
        "kind": "metric",
        "unit": "m",
        "scale": 1000.0,
        "scenes": 1,
        "flicker": done.flicker,
        "flicker_unsmoothed": done.flicker_unsmoothed if smooth_s else None,
        "smooth_s": smooth_s,
        "look_ahead": 8,
        "lock_s": 1.0,
        "model": "tiny",
        "model_sha256": loader.load().model.sha256,
        "focal_px": pytest.approx(32 / math.tan(math.radians(30))),
        "centre_px": None,
        "camera_source": "option",
        "pixel_aspect": 1.0,
        "camera": "hfov 60.0° (given)",
        "anchors": None,
    }


@pytest.mark.parametrize(
    ("output", "formats"),
    [
        ("a.gif", ()),
        ("-", (VideoFormat.EXR,)),
        ("-", (VideoFormat.MKV, VideoFormat.MP4)),
        ("a.mkv", (VideoFormat.PNG16,)),
        ("a.mkv", (VideoFormat.MP4,)),
        (None, (VideoFormat.JSON,)),
        ("a.%d.png", (VideoFormat.EXR,)),
        ("c/y.exr", ()),
        ("y.png", (VideoFormat.PNG16,)),
        ("y.%04d.preview.png", ()),
        ("y.preview.png", ()),
        ("vid.v003", ()),
    ],
)
def test_outputs_that_do_not_fit(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    output: str | None,
    formats: tuple[VideoFormat, ...],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "clip.mp4").write_bytes(b"never read")
    with pytest.raises(UsageError):
        video(video_request("clip.mp4", output, formats))
    assert files(tmp_path) == {"clip.mp4"}


def test_outputs_that_do_not_fit_the_video(tmp_path: Path) -> None:
    clip = str(write_video(tmp_path / "a.mkv", flat_frames(range(2))))
    with pytest.raises(UsageError, match="webm file holds no h264"):
        video(video_request(clip, None, (VideoFormat.WEBM,), codec=PreviewCodec.H264))
    (tmp_path / "b.mkv").symlink_to("a.mkv")
    with pytest.raises(OutputError, match="is an input"):
        video(video_request(clip, str(tmp_path / "b.mkv")))
    assert files(tmp_path) == {"a.mkv", "b.mkv"}


class Stream(io.BytesIO):
    """Bytes that come and go as through a pipe: front to back."""

    def seekable(self) -> bool:
        return False

    def read1(self, size: int | None = -1) -> bytes:
        return super().read1(min(size or 1, 1000))


@pytest.mark.parametrize(
    ("suffix", "codec"),
    [("mkv", "mpeg4"), ("ts", "mpeg2video"), ("nut", "ffv1"), ("y4m", "rawvideo")],
)
def test_standard_input_gives_the_bytes_of_a_file(
    tmp_path: Path, loader: SessionLoader, suffix: str, codec: str
) -> None:
    path = tmp_path / f"a.{suffix}"
    encode(path, flat_frames(range(24)), NTSC, codec, "yuv420p")
    piped = Stream(path.read_bytes())
    done = video(video_request("-", f"{tmp_path}/piped.mkv", model=loader, stdin=piped))
    run(path, tmp_path / "file.mkv", loader)
    assert (done.name, done.frames, done.rate, done.problem) == ("-", 24, NTSC, None)
    assert (tmp_path / "piped.mkv").read_bytes() == (tmp_path / "file.mkv").read_bytes()


def test_outputs_of_stdin_are_named_so(clip: Path, tmp_path: Path, loader: SessionLoader) -> None:
    with clip.open("rb") as stream:  # it seeks, so that MP4 with its header at the end does
        request = video_request("-", f"{tmp_path}/out/", sidecar=True, model=loader, stdin=stream)
        assert video(request).frames == 24
    suffixes = ("depth.mkv", "preview.mp4", "depth.json")
    assert files(tmp_path / "out") == {f"stdin.{suffix}" for suffix in suffixes}


@pytest.mark.parametrize("which", VIDEOS)
def test_standard_output_takes_the_frames_of_a_file(
    clip: Path, tmp_path: Path, loader: SessionLoader, which: VideoFormat
) -> None:
    stream = Stream()
    request = video_request(clip, "-", (which,), model=loader, stdout=stream)
    assert video(request).outputs == ("-",)
    piped, whole = (tmp_path / f"{name}{which.facts.suffix}" for name in "ab")
    piped.write_bytes(stream.getvalue())
    run(clip, whole, loader)
    assert times_ms(piped) == times_ms(whole)
    np.testing.assert_array_equal(colours(piped), colours(whole))
    assert files(tmp_path) == {"model", "clip.mp4", piped.name, whole.name}


@pytest.mark.parametrize("reason", [KeyboardInterrupt(), SystemExit(143), BrokenPipeError()])
def test_an_exception_of_a_pipe_passes_through_ffmpeg(
    clip: Path, tmp_path: Path, loader: SessionLoader, reason: BaseException
) -> None:
    class Stopped(Stream):
        left = 3

        def _stop(self) -> None:
            self.left -= 1
            if not self.left:
                raise reason

        def read1(self, size: int | None = -1) -> bytes:
            self._stop()
            return super().read1(size)

        def write(self, data: Any) -> int:
            self._stop()
            return super().write(data)

    encode(tmp_path / "in.mkv", flat_frames(range(9)), NTSC, "mpeg4", "yuv420p")
    piped = Stopped((tmp_path / "in.mkv").read_bytes())
    with pytest.raises(type(reason)):
        video(video_request("-", f"{tmp_path}/a.mkv", model=loader, stdin=piped))
    with pytest.raises(type(reason)):
        video(video_request(clip, "-", model=loader, stdout=Stopped()))
    assert files(tmp_path) == {"model", "clip.mp4", "in.mkv"}


@pytest.mark.parametrize("data", [b"", b"no video" * 999, b"mp4"])
def test_a_pipe_without_a_video_says_what_to_send(
    clip: Path, tmp_path: Path, loader: SessionLoader, data: bytes
) -> None:
    if data == b"mp4":  # its header is behind more than FFmpeg looks at
        data = clip.read_bytes().replace(b"mdat", b"mdat" + bytes(6_000_000), 1)
    with pytest.raises(InputError):
        video(video_request("-", f"{tmp_path}/a.mkv", model=loader, stdin=Stream(data)))


def test_empty_names_are_not_the_working_directory(
    clip: Path, tmp_path: Path, loader: SessionLoader, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(3):
        write_image(tmp_path / "shot" / f"{number:04}.png")
    monkeypatch.chdir(tmp_path / "shot")
    with pytest.raises(InputError):
        video(VideoRequest("", model=loader))
    for formats in ((), (VideoFormat.MKV,), (VideoFormat.PNG16,)):
        with pytest.raises(UsageError):
            video(video_request(clip, "", formats, model=loader))
    assert files(tmp_path / "shot") == {"0000.png", "0001.png", "0002.png"}


RESUMED = [
    (VideoFormat.MKV, VideoFormat.MOV, VideoFormat.PNG16),
    (VideoFormat.MP4, VideoFormat.NPY),
    (VideoFormat.EXR,),
]


def hidden(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize("formats", RESUMED)
def test_a_video_that_was_stopped_twice_goes_on_to_the_same_bytes(
    clip: Path, tmp_path: Path, loader: SessionLoader, formats: tuple[VideoFormat, ...]
) -> None:
    request = video_request(clip, f"{tmp_path}/out/", formats, sidecar=True, model=loader)
    for last in (15, 6):
        with pytest.raises(KeyboardInterrupt):
            video(request, Watched(last=last))
    out = tmp_path / "out"
    assert not [*out.glob("clip.*.m*"), *out.glob("*.json")]
    assert len(hidden(out)) == 1
    frames = sorted(out.glob("clip.*"))
    frames[2].write_bytes(b"damaged")
    frames[3].unlink()
    written_ns = [path.stat().st_mtime_ns for path in frames[6:9]]
    done = video(request)
    assert [path.stat().st_mtime_ns for path in frames[6:9]] == written_ns
    there = video_destination(f"{tmp_path}/whole/", formats, sidecar=True)
    whole = video(dataclasses.replace(request, destination=there))
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")
    assert (done.frames, done.flicker, done.warnings) == (24, whole.flicker, whole.warnings)


@pytest.mark.parametrize(
    ("which", "writing"),
    [
        (VideoFormat.PNG16, WriterOptions(png_normalize=True)),
        (VideoFormat.PNG16, WriterOptions(png_inverse=True, vmin=0.5, vmax=8)),
        (VideoFormat.EXR, WriterOptions(half=True)),
    ],
)
def test_frames_that_keep_less_than_their_depth_tell_no_other_figures(
    clip: Path, tmp_path: Path, loader: SessionLoader, which: VideoFormat, writing: WriterOptions
) -> None:
    settings = VideoSettings(writing=writing, span=Span(end=frame_number(9)))
    request = VideoRequest(str(clip), model=loader, settings=settings)
    there = video_destination(f"{tmp_path}/whole/", (which,), sidecar=True)
    whole = video(dataclasses.replace(request, destination=there))
    for folder, sidecar in (("alone", False), ("described", True)):
        there = video_destination(f"{tmp_path}/{folder}/", (which,), sidecar=sidecar)
        again = dataclasses.replace(request, destination=there)
        with pytest.raises(KeyboardInterrupt):
            video(again, Watched(last=5))
        assert video(again).flicker == pytest.approx(whole.flicker, rel=1e-2)
    frames = {n: d for n, d in contents(tmp_path / "whole").items() if not n.endswith(".json")}
    assert contents(tmp_path / "alone") == frames
    assert contents(tmp_path / "described") == contents(tmp_path / "whole")


@pytest.mark.parametrize(
    "settings",
    [
        VideoSettings(writing=WriterOptions(png_scale=256)),
        VideoSettings(span=Span(frame_number(1)), start_number=0),
    ],
)
def test_frames_of_another_request_are_done_again(
    clip: Path, tmp_path: Path, loader: SessionLoader, settings: VideoSettings
) -> None:
    request = video_request(clip, f"{tmp_path}/out/", (VideoFormat.PNG16,), model=loader)
    with pytest.raises(KeyboardInterrupt):
        video(request, Watched(last=9))
    for folder in ("out", "whole"):
        there = video_destination(f"{tmp_path}/{folder}/", (VideoFormat.PNG16,))
        video(dataclasses.replace(request, destination=there, settings=settings))
    for path in (tmp_path / "whole").iterdir():
        assert (tmp_path / "out" / path.name).read_bytes() == path.read_bytes()


def test_a_run_that_cannot_be_resumed_ends_the_record_of_an_earlier_one(
    clip: Path, tmp_path: Path, loader: SessionLoader
) -> None:
    request = video_request(clip, f"{tmp_path}/out/", (VideoFormat.NPY,), model=loader)
    with pytest.raises(KeyboardInterrupt):
        video(request, Watched(last=12))
    assert hidden(tmp_path / "out")
    video(dataclasses.replace(request, settings=VideoSettings(smooth_s=0.2)))
    assert not hidden(tmp_path / "out")
    for folder in ("out", "whole"):
        there = video_destination(f"{tmp_path}/{folder}/", (VideoFormat.NPY,))
        video(dataclasses.replace(request, destination=there))
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


@pytest.mark.parametrize(
    ("output", "formats", "names"),
    [
        ("vid.v003", "mkv mp4", "vid.v003.depth.mkv vid.v003.preview.mp4"),
        ("vid.v003", "mkv", "vid.v003.depth.mkv"),
        ("vid.v003", "exr", "vid.v003.depth.%06d.exr"),
        ("vid.v003.mkv", "mkv", "vid.v003.mkv"),
        ("vid.v003.mkv", "mkv mp4", "vid.v003.depth.mkv vid.v003.preview.mp4"),
        ("d.depth.mkv", "mkv mp4", "d.depth.mkv d.preview.mp4"),
        ("d.preview.png", "mkv mp4", "d.depth.mkv d.preview.mp4"),
        ("vid", "mkv", "a.depth.mkv"),  # a folder
        ("n.%04d.png", "normals", "n.%04d.png"),
        ("n.%04d.png", "png16", "n.%04d.png"),
        ("vid.v003.mp4", "stereo", "vid.v003.mp4"),
    ],
)
def test_only_the_suffix_of_a_format_is_one(output: str, formats: str, names: str) -> None:
    parsed = tuple(VideoFormat(word) for word in formats.split())
    assert " ".join(plan_video(video_request("a.mov", output, parsed)).names.values()) == names
    described = plan_video(video_request("a.mov", "d.v1", (VideoFormat.NPY,), sidecar=True))
    assert described.names[VideoFormat.JSON] == "d.v1.depth.json"


def test_outputs_hold_equal_millimetres(clip: Path, tmp_path: Path, loader: SessionLoader) -> None:
    out = tmp_path / "out"
    done = video(video_request(clip, out, tuple(VideoFormat), model=loader))
    names = [f"clip{name.facts.suffix}" for name in VideoFormat]
    assert sorted(done.outputs) == sorted(str(out / name) for name in names)
    pipeline = load(tmp_path / "model", detail=UpsamplingOptions())
    with VideoSource(clip) as source:
        expected = [np.rint(pipeline.predict(f).depth.values * 1000) for f in source.frames()]
    steps = list(DepthVideo(out / "clip.depth.mkv").steps())
    np.testing.assert_array_equal(steps, expected)
    for index, step in enumerate(steps):
        png = cv2.imread(str(out / f"clip.depth.{index:06d}.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(step, png)
        for suffix in ("exr", "npy"):
            metres = read_stored_depth(out / f"clip.depth.{index:06d}.{suffix}").displayed.values
            np.testing.assert_array_equal(step, np.rint(metres * 1000))
    assert len(files(out)) == len(set(VideoFormat) - set(SEQUENCES)) + 24 * len(SEQUENCES)


def test_workers_write_what_one_does(clip: Path, tmp_path: Path, loader: SessionLoader) -> None:
    for workers in (1, 4):
        settings = VideoSettings(smooth_s=0.1)
        request = video_request(
            clip, f"{tmp_path}/w{workers}/", model=loader, settings=settings, workers=workers
        )
        video(request)
    for name in ("clip.depth.mkv", "clip.preview.mp4"):
        alone, four = ((tmp_path / f"w{n}" / name).read_bytes() for n in (1, 4))
        assert alone == four
    # With it, x264 gives about one in a hundred videos other bytes.
    assert b"mbtree=0" in alone


def times_ms(path: Path) -> list[float]:
    """When a video's frames are shown, as another program sees it."""
    capture, times = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG), []
    while capture.grab():
        times.append(capture.get(cv2.CAP_PROP_POS_MSEC))
    return times


def test_a_part_of_a_video(clip: Path, tmp_path: Path, loader: SessionLoader) -> None:
    run(clip, tmp_path / "whole.mkv", loader)
    span = Span(Point(Fraction("0.2")), frame_number(20), frame_number(3))
    formats = (VideoFormat.PNG16, VideoFormat.MKV)
    settings = VideoSettings(span=span)
    done = video(video_request(clip, f"{tmp_path}/p/", formats, model=loader, settings=settings))
    indices = [6, 9, 12, 15, 18]
    assert (done.frames, done.first.index, done.rate) == (5, 6, NTSC / 3)
    assert done.first.timestamp_s == pytest.approx(6 * 1001 / 30000)
    assert done.first.pixels.size == 1  # of a frame only what it says is kept
    names = {f"clip.depth.{i:06d}.png" for i in indices}
    assert files(tmp_path / "p") == {"clip.depth.mkv"} | names
    steps = list(DepthVideo(tmp_path / "whole.mkv").steps())
    part = list(DepthVideo(tmp_path / "p" / "clip.depth.mkv").steps())
    np.testing.assert_array_equal(part, [steps[i] for i in indices])
    assert times_ms(tmp_path / "p" / "clip.depth.mkv") == pytest.approx(
        [round(i * 3 * 1001 / 30) for i in range(5)]  # the part begins at 0
    )


def noisy(path: Path, scenes: int = 2, length: int = 25) -> Path:
    """Still scenes under noise, each of its own brightness."""
    rng = np.random.default_rng(0)
    # Its squares show the optical flow that nothing moves.
    squares = np.kron(rng.uniform(0, 60, (6, 8, 1)), np.ones((24, 24, 1)))
    frames = [
        np.clip(squares + 50 + 90 * scene + rng.normal(0, 9, (144, 192, 1)), 0, 255)
        .astype(np.uint8)
        .repeat(3, 2)
        for scene in range(scenes)
        for _ in range(length)
    ]
    return write_video(path, frames)


def test_smoothing_lowers_flicker_and_stops_at_a_cut(tmp_path: Path, loader: SessionLoader) -> None:
    path = noisy(tmp_path / "noise.avi")
    before = run(path, tmp_path / "raw.mkv", loader)
    after = run(path, tmp_path / "smooth.mkv", loader, smooth_s=0.3)
    assert before.scenes == after.scenes == 2
    assert before.flicker is not None
    assert after.flicker is not None
    # Without smoothing it is measured on what the file holds, whole millimetres.
    assert after.flicker_unsmoothed == pytest.approx(before.flicker, rel=1e-4)
    assert after.flicker < before.flicker / 2
    first, second = (
        [depth.values for depth in DepthVideo(tmp_path / name)]
        for name in ("raw.mkv", "smooth.mkv")
    )
    for scene in (slice(0, 25), slice(25, 50)):  # nothing of one is in the other
        np.testing.assert_allclose(
            np.median(second[scene], (1, 2)), np.median(first[scene]), atol=0.05
        )
    assert np.median(second[24]) < np.median(first[25]) - 1
    noise = [
        np.std([values[20:28] for values in maps[10:25]], axis=0).mean() for maps in (first, second)
    ]
    assert noise[1] < 0.6 * noise[0]


@pytest.mark.parametrize("smooth_s", [0.0, 0.2])
def test_each_frame_states_its_time(tmp_path: Path, loader: SessionLoader, smooth_s: float) -> None:
    times_s = [0, 0.04, 0.1, 0.12]
    path = write_mp4(tmp_path / "a.mp4", flat_frames([9, 50, 99, 200]), Fraction(25), times_s)
    formats = VideoFormat.MKV, VideoFormat.PNG16, VideoFormat.EXR, VideoFormat.NPY, VideoFormat.JSON
    settings = VideoSettings(span=Span(frame_number(1)), smooth_s=smooth_s)
    video(video_request(path, f"{tmp_path}/o/", formats, model=loader, settings=settings))
    for i in (1, 2, 3):
        for suffix in ("png", "exr", "npy"):
            file = tmp_path / "o" / f"a.depth.{i:06}.{suffix}"
            assert float(read_metadata(file)["time_s"]) == pytest.approx(times_s[i], abs=1e-9)
            assert depthcli.read_depth(file).time_s == pytest.approx(times_s[i], abs=1e-9)
    times = json.loads((tmp_path / "o" / "a.depth.json").read_text())["times_s"]
    assert times == pytest.approx({str(i): times_s[i] for i in (1, 2, 3)}, abs=1e-9)
    read = depthcli.DepthVideo(tmp_path / "o" / "a.depth.mkv")
    assert "time_s" not in read.labels
    assert [depth.time_s for depth in read] == pytest.approx(times_s[1:], abs=0.0006)
    frame = ConvertRequest(
        str(read.path), str(tmp_path / "c.png"), stated=DepthReadOptions(frame=1)
    )
    assert (
        read_stored_depth(convert(frame).target).displayed.provenance
        == next(itertools.islice(read, 1, 2)).provenance
    )


@pytest.mark.parametrize(
    ("pattern", "sidecar"),
    [
        ("d.%04d.npy", "d.json"),
        ("left_#####_depth.npy", "left.json"),
        ("d.%04d.v003.npy", "d.json"),
        ("2_%04d_of_9.v1.npy", "2.json"),
        ("%04d.v003.npy", "sequence.json"),
        ("%d.npy", "sequence.json"),
    ],
)
def test_numbered_arrays_find_their_time_and_kind_in_the_sidecar(
    pattern: str, sidecar: str, tmp_path: Path
) -> None:
    loader = SessionLoader(write_model(tmp_path / "model", output__kind="relative"), "cpu")
    clip = write_video(tmp_path / "a.avi", flat_frames(range(3)))
    settings = VideoSettings(start_number=1001)
    video(
        video_request(clip, f"{tmp_path}/{pattern}", sidecar=True, model=loader, settings=settings)
    )
    assert (tmp_path / sidecar).exists()
    for number in range(3):
        depth = depthcli.read_depth(tmp_path / numbered_name(pattern, 1001 + number))
        assert (depth.time_s, depth.kind.value) == (number / 25, "relative")
    np.save(tmp_path / numbered_name(pattern, 1004), np.ones((2, 2), np.float32))  # no frame of it
    other = depthcli.read_depth(tmp_path / numbered_name(pattern, 1004))
    assert (other.time_s, other.kind.value) == (None, "metric")


def colours(path: Path) -> list[np.ndarray[Any, Any]]:
    capture = cv2.VideoCapture(str(path))
    frames = []
    while True:
        ok, pixels = capture.read()
        if not ok:
            return frames
        frames.append(pixels.astype(int))


def test_the_lock_holds_colours_and_lets_go_at_a_cut(tmp_path: Path, loader: SessionLoader) -> None:
    background = np.repeat(np.linspace(90, 160, 64).astype(np.uint8)[None, :], 48, 0)
    frames = []
    for i in range(30):
        image = background.copy()
        image[:6] = image[:6] if i < 15 else 250  # something far comes into the image
        frames.append(image)
    frames += [np.full_like(background, 20)] * 3
    path = write_video(tmp_path / "a.avi", [np.repeat(f[..., None], 3, 2) for f in frames])
    gray = WriterOptions(colormap="gray", near="white")
    for lock_s in (0, 5):
        run(path, tmp_path / f"{lock_s}.mp4", loader, lock_s=lock_s, writing=gray)
    free, held = (colours(tmp_path / f"{lock_s}.mp4") for lock_s in (0, 5))
    jump = [abs(f[16][40, 32] - f[13][40, 32]).max() for f in (free, held)]
    assert jump[0] > 40  # without it the change of one part repaints the rest
    assert jump[1] < 15
    assert abs(free[-1] - held[-1]).max() < 20


def test_a_name_that_is_too_long_ends_before_any_frame(clip: Path, loader: SessionLoader) -> None:
    longest = clip.rename(clip.with_name("a" * 247 + ".mp4"))
    progress = Watched()
    with pytest.raises(OutputError):
        video(VideoRequest(str(longest), model=loader), progress)
    assert progress.done == 0
