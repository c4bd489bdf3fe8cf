"""``depthcli video``: the command and its options."""

from __future__ import annotations

import re
from contextlib import nullcontext
from typing import TYPE_CHECKING

import typer

from depthcli.cli import groups, options, parse
from depthcli.core.options import Eye, short_repr
from depthcli.errors import ExitCode, InputError, OutputError, UsageError
from depthcli.io.formats.table import WriterOptions
from depthcli.video.container import RawVideo, live_stream
from depthcli.video.formats import PreviewCodec, VideoFormat
from depthcli.video.frames import Point, Span

if TYPE_CHECKING:
    from depthcli.jobs.video.plan import VideoResult


_MINUTE = 60
_GRACE_PERIOD_S = 600.0  # in which a long recording is completed
_POINT = re.compile(r"(?a)((?:\d+:){0,2})(\d+(?:\.\d*)?|\.\d+)([sf]?)")

FORMAT_OPTIONS = {str(which): which.facts.options for which in VideoFormat}
"""The options that each format uses, by parameter name."""
_IN_STEPS = {VideoFormat.MKV, VideoFormat.PNG16}


@groups.group
class OutputOptions:
    """Output."""

    out: str | None = options.usual(
        "Output .mkv, .mp4, .webm or .mov file, numbered files (d.%04d.exr), folder "
        "(existing, ending in '/', or without suffix), or '-' for stdout. Default: next to the "
        "video.",
        "-o",
        "--out",
        metavar="OUT",
    )
    formats: list[VideoFormat] | None = options.usual(
        "Output format; repeatable: mkv (lossless 16-bit depth), mp4, webm, mov "
        "(previews), stereo (mp4), png16, exr, npy, normals (one file per frame), json. Default: "
        "from the suffix of OUT, else mkv and mp4, or mkv alone to stdout.",
        "--format",
    )
    sidecar: options.SidecarOption = False
    overwrite: options.OverwriteOption = False
    segment: str | None = options.option(
        "Length of each video file (30s, 10m, 1h): out.0000.mkv, out.0001.mkv and so on.",
        metavar="TIME",
    )
    start_number: int | None = options.option(
        "Number of the first numbered file. Default: that of its frame in the input.",
        min=0,
        max=1_000_000_000,
    )


@groups.group
class FrameOptions:
    """Choosing frames."""

    start: str | None = options.option(
        "First frame: seconds (12.5, 1:02.5) or a frame number (300f).", metavar="TIME"
    )
    end: str | None = options.option(
        "End frame (exclusive), in the same notation as --start.", metavar="TIME"
    )
    every: str | None = options.option(
        "Process every STEP-th frame (2), or one frame per interval (0.5s).", metavar="STEP"
    )
    fps: str | None = options.option(
        "Frames per second of an image sequence: 24, 23.976 or 24000/1001. Default: as "
        "its EXR headers state, else 25.",
        metavar="RATE",
    )
    live: bool = options.option(
        "Read FILE (http(s):// or '-') as an endless stream, always its newest frame, until "
        "Ctrl-C. Default: for cameras, rtsp:// and .m3u8.",
        default=False,
    )
    raw: str | None = options.option(
        "Size, pixel format and rate of frames without a container on stdin, as ffmpeg -f "
        "rawvideo pipes them: 640x480:bgr24@30.",
        metavar="SIZE:FORMAT@RATE",
    )
    stream: int | None = options.option(
        "Number of the video stream, from 0. Default: the one with most frames.", min=0
    )
    eye: Eye | None = options.option(
        "View to use from a stereo video whose frames hold two, side by side or one above the "
        "other. Default: whole frames."
    )


@groups.group
class PreviewVideoOptions:
    """Preview."""

    lock: float = options.option(
        "Time constant in seconds for stabilizing the preview's range. 0: each frame has its own.",
        default=1.0,
        callback=options.not_negative,
    )
    codec: PreviewCodec | None = options.option(
        "Codec of the preview: h264 (mp4, mov), vp9 or av1 (webm, mp4), prores (mov). "
        "Default: h264 in mp4, vp9 in webm, prores in mov."
    )
    audio: bool = options.option("Include the audio of the video in previews.", default=True)
    show: int | None = options.option(
        "Show the newest preview at http://127.0.0.1:PORT/ during the run.",
        metavar="PORT",
        min=1,
        max=65535,
    )


@groups.group
class SmoothOptions(options.MapOptions):
    """Detail."""

    smooth: float = options.option(
        "Time constant of temporal smoothing in seconds (for example 0.2). 0 disables it.",
        default=0.0,
        callback=options.not_negative,
    )
    look_ahead: int | None = options.option(
        "Later frames that --smooth takes into account. Default: 8, for live streams 0.",
        min=0,
        max=100,
    )


@groups.group
class FrameFitOptions(options.FitOptions):
    """Known depth."""

    anchors_within: float | None = options.option(
        "Largest time in seconds between a frame and the known depth nearest to it (for example "
        "0.05 for a lidar of 10 Hz). Default: half a frame.",
        callback=options.not_negative,
    )


def video(
    file: str = typer.Argument(
        ...,
        metavar="FILE",
        help="Input video, '-' for stdin; an image sequence: a pattern (plate.%04d.exr) or a "
        "folder; or a live stream: a camera (0), rtsp:// or, with --live, http(s):// and '-'.",
    ),
    *,
    output: OutputOptions,
    frames: FrameOptions,
    model: options.ModelOptions,
    workers: options.WorkersOption = None,
    camera: options.CameraOptions,
    anchors: FrameFitOptions,
    read: options.ImageOptions,
    detail: SmoothOptions,
    writing: WriterOptions,
    preview: PreviewVideoOptions,
    screen: options.ScreenOptions,
    explicit: groups.Given,
) -> int:
    """Estimate depth for every frame of a video.

    Writes lossless 16-bit video in millimetres, a preview video, or one file per frame.

    Exit codes: 0 success, 1 the video cannot be read to its end, 2 usage error, 3 model error.
    """
    from depthcli.cli.screen import console
    from depthcli.cli.shell import graceful_shutdown
    from depthcli.io.storage.paths import safe_name
    from depthcli.jobs.image import FailedInput
    from depthcli.jobs.outputs import STDIO
    from depthcli.jobs.video import run as job
    from depthcli.jobs.video.plan import LOOK_AHEAD, VideoRequest, VideoSettings, video_destination

    to_stdout = output.out == STDIO
    if screen.as_json and to_stdout:
        raise UsageError("-o - and --json both write to stdout; name a file with -o")
    destination = video_destination(output.out, output.formats or (), sidecar=output.sidecar)
    raw = None if frames.raw is None else parse_raw(frames.raw)
    stream = live_stream(
        file, is_live=frames.live, raw=raw, say=lambda text: screen.warn_all([text])
    )
    look_ahead = detail.look_ahead
    if look_ahead is None:
        look_ahead = LOOK_AHEAD if stream is None else 0  # a stream is shown as it comes
    settings = VideoSettings(
        **parse.map_options(camera, anchors, read, detail, writing, is_folder=None, eye=frames.eye),
        span=parse_span(frames.start, frames.end, frames.every),
        smooth_s=detail.smooth,
        look_ahead=look_ahead,
        lock_s=preview.lock,
        anchors_within_s=anchors.anchors_within,
        stream=frames.stream,
        fps=None if frames.fps is None else parse.fps(frames.fps),
        segment_s=None if output.segment is None else parse_segment(output.segment),
        start_number=output.start_number,
    )
    if settings.writing.is_normalized and set(destination.formats) >= _IN_STEPS:
        raise UsageError("mkv is in millimetres", "leave out mkv, or write png16 in metres")
    page = None
    if preview.show is not None:
        from depthcli.jobs.video.page import PreviewPage

        page = PreviewPage(preview.show, settings.writing)
        if not screen.quiet:
            console.note(f"previews at http://127.0.0.1:{preview.show}/")
    request = VideoRequest(
        video=file,
        destination=destination,
        overwrite=output.overwrite,
        codec=preview.codec,
        has_audio=preview.audio,
        model=parse.session_loader(model.model, model.runtime),
        settings=settings,
        workers=workers,
        live=stream,
        raw=raw,
        page=page,
    )
    formats = [*destination.wanted, *([] if page is None else [VideoFormat.MP4])]
    unused = parse.unused_by_outputs(explicit, formats, settings.writing, FORMAT_OPTIONS)
    screen.warn_all([*settings.camera.warnings, *unused])
    result: VideoResult | FailedInput
    try:
        with (
            nullcontext()
            if stream is None
            else graceful_shutdown(_GRACE_PERIOD_S, stream.stop.set),
            screen.show_progress() as progress,
        ):
            result = job.video(request, progress)
    except (InputError, OutputError) as error:
        result = FailedInput(safe_name(file), error)
    from depthcli.cli.screen.results import print_result  # its imports are loaded by now

    print_result(result, screen, to_stderr=to_stdout)
    is_whole = not isinstance(result, FailedInput) and result.problem is None
    return ExitCode.OK if is_whole else ExitCode.SOME_FAILED


def parse_span(start: str | None, end: str | None, every: str | None) -> Span:
    """Parse the part of a video to process."""
    first = _point(start or "0", "start")
    last = None if end is None else _point(end, "end")
    step = _point(every or "1", "every", bare_is_frames=True)
    if not step.value:
        raise UsageError("0 is not a step", "give 1 or more", option="every")
    return Span(first, last, step)


def parse_segment(word: str) -> float:
    """Parse a length: ``30s``, ``10m`` or ``1h``, in seconds without a letter."""
    match = re.fullmatch(r"(?a)(\d{1,6}(?:\.\d{1,3})?)([smh]?)", word.strip())
    length_s = float(match[1]) * {"m": 60, "h": 3600}.get(match[2], 1) if match else 0
    if not length_s:
        problem = f"{short_repr(word)} is not a length such as 30s, 10m or 1h"
        raise UsageError(problem, option="segment")
    return length_s


def parse_raw(word: str) -> RawVideo:
    """Parse ``640x480:bgr24@30``; UsageError if it is no such."""
    size, _, rest = word.partition(":")
    pixel_format, _, rate = rest.partition("@")
    return RawVideo(*parse.size(size, "raw"), pixel_format, parse.fps(rate, "raw"))


def _point(word: str, option: str, *, bare_is_frames: bool = False) -> Point:
    """Parse ``12.5``, ``12.5s``, ``1:02.5``, ``1:00:00`` or ``300f``.

    A number without a unit is in seconds, or in frames with ``bare_is_frames``.
    """
    from fractions import Fraction

    match = _POINT.fullmatch(word.strip())
    outer, number, letter = match.groups() if match else ("", "nan", "")
    in_frames = letter == "f" or (not letter and not outer and bare_is_frames)
    if match is None or (in_frames and (outer or not number.isdecimal())):
        advice = "give seconds (12.5s), minutes (1:02.5) or a frame number (300f)"
        problem = f"{short_repr(word)} is not a time or frame number"
        raise UsageError(problem, advice, option=option)
    value = Fraction(0)
    for part in (outer + number.removesuffix(".")).split(":"):
        value = value * _MINUTE + Fraction(part)
    return Point(value, in_frames)
