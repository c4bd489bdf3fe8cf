"""``depthcli video``: the command and its options."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli import options
from depthcli.cli.options import not_negative
from depthcli.cli.screen import console
from depthcli.core.options import MAX_PIXELS, Upsampling
from depthcli.errors import ExitCode, InputError, OutputError, UsageError
from depthcli.video.formats import PreviewCodec, VideoFormat

if TYPE_CHECKING:
    from depthcli.jobs.video.run import VideoResult

app = typer.Typer(rich_markup_mode=None)


@app.command()
def video(
    context: typer.Context,
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE",
            help="Input video, '-' for stdin, or an image sequence: a pattern (plate.%04d.exr) or "
            "a folder.",
        ),
    ],
    output: Annotated[
        str | None,
        typer.Option(
            "-o",
            "--out",
            "--output",
            metavar="OUT",
            help="Output .mkv, .mp4, .webm or .mov file, numbered files (d.%04d.exr), folder "
            "(existing, ending in '/', or without suffix), or '-' for stdout. Default: next to the "
            "video.",
        ),
    ] = None,
    formats: Annotated[
        list[VideoFormat] | None,
        typer.Option(
            "--format",
            help="Output format; repeatable: mkv (lossless 16-bit depth), mp4, webm, mov "
            "(previews), png16, exr, npy (one file per frame), json. Default: from the suffix of "
            "OUT, else mkv and mp4, or mkv alone to stdout.",
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="TIME", help="First frame: seconds (12.5, 1:02.5) or a frame number (300f)."
        ),
    ] = None,
    end: Annotated[
        str | None,
        typer.Option(
            metavar="TIME", help="End frame (exclusive), in the same notation as --start."
        ),
    ] = None,
    every: Annotated[
        str | None,
        typer.Option(
            metavar="STEP",
            help="Process every STEP-th frame (2), or one frame per interval (0.5s).",
        ),
    ] = None,
    fps: Annotated[
        str | None,
        typer.Option(
            metavar="RATE",
            help="Frames per second of an image sequence: 24, 23.976 or 24000/1001. Default: as "
            "its EXR headers state, else 25.",
        ),
    ] = None,
    start_number: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=1_000_000_000,
            help="Number of the first frame in names of files. Default: its number in the input.",
        ),
    ] = None,
    smooth: Annotated[
        float,
        typer.Option(
            callback=not_negative,
            help="Time constant of temporal smoothing in static regions, in seconds (for example "
            "0.2). 0 disables it.",
        ),
    ] = 0.0,
    lock: Annotated[
        float,
        typer.Option(
            callback=not_negative,
            help="Time constant in seconds for stabilizing the preview's range. 0: range of each "
            "frame.",
        ),
    ] = 1.0,
    codec: Annotated[
        PreviewCodec | None,
        typer.Option(
            help="Codec of the preview: h264 (mp4, mov), vp9 or av1 (webm, mp4), prores (mov). "
            "Default: h264 in mp4, vp9 in webm, prores in mov."
        ),
    ] = None,
    audio: Annotated[bool, typer.Option(help="Include the audio of the video in previews.")] = True,
    model: options.ModelOption = None,
    provider: options.ProviderOption = "auto",
    provider_option: options.ProviderSettingsOption = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, max=1024, help="Frames processed in parallel. Default: one per core."),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(
            min=1, max=1024, help="Inference threads per worker. Default: cores / workers."
        ),
    ] = None,
    png_scale: options.PngScaleOption = None,
    png_normalize: options.PngNormalizeOption = False,
    exr_channel: options.ExrChannelOption = options.ExrChannel.Y,
    half: options.HalfOption = False,
    colormap: options.ColormapOption = None,
    near: options.NearOption = None,
    vmin: options.VminOption = None,
    vmax: options.VmaxOption = None,
    legend: options.LegendOption = False,
    side_by_side: options.SideBySideOption = False,
    sidecar: options.SidecarOption = False,
    focal_px: options.FocalPxOption = None,
    hfov: options.HfovOption = None,
    centre_px: options.CentrePxOption = None,
    calibration: options.CalibrationOption = None,
    rectified: options.RectifiedOption = False,
    white_level: options.WhiteLevelOption = None,
    exposure: options.ExposureOption = 0.0,
    layer: options.LayerOption = None,
    upsample: options.UpsampleOption = Upsampling.GUIDED,
    tile: options.TileOption = None,
    max_pixels: options.MaxPixelsOption = MAX_PIXELS,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object to stdout at the end.")
    ] = False,
    quiet: options.QuietOption = False,
) -> int:
    """Estimate depth for every frame of a video.

    Writes lossless 16-bit video in millimetres, a preview video, or one file per frame.

    Exit codes: 0 success, 1 the video cannot be read to its end, 2 usage error, 3 model error.
    """
    from depthcli.cli.checks import refuse_for_frames, refuse_unused
    from depthcli.cli.parse import (
        choose_camera,
        choose_codec,
        choose_detail,
        parse_fps,
        parse_span,
        read_options,
        refuse_for_videos,
        refuse_replacing,
        session_loader,
        writer_options,
    )
    from depthcli.cli.screen.progress import show_progress
    from depthcli.io.storage.paths import safe_name
    from depthcli.jobs.outputs import FailedInput
    from depthcli.jobs.video import run as job
    from depthcli.jobs.video.plan import STDIO, VideoRequest, VideoSettings, video_formats

    to_stdout = output == STDIO
    if as_json and to_stdout:
        raise UsageError("-o - and --json both write to stdout; name a file with -o")
    refuse_replacing(calibration, output)
    writing = writer_options(context.params)
    camera = choose_camera(context.params)
    chosen = video_formats(output, formats or ())
    if png_normalize and {VideoFormat.MKV, VideoFormat.PNG16} <= set(chosen):
        raise UsageError("--png-normalize stretches png16, and mkv is in millimetres: give one")
    written = [*chosen, VideoFormat.JSON] if sidecar else chosen
    refuse_unused(context, written, {which: which.facts.options for which in VideoFormat})
    refuse_for_videos(context, file)
    request = VideoRequest(
        video=file,
        output=output,
        formats=chosen,
        sidecar=sidecar,
        codec=choose_codec(context, codec, chosen),
        has_audio=audio,
        model=session_loader(model, provider, threads, provider_option),
        settings=VideoSettings(
            writing=writing,
            span=parse_span(start, end, every),
            smooth_s=smooth,
            lock_s=lock,
            camera=camera,
            reading=read_options(context.params),
            detail=choose_detail(upsample, tile),
            max_pixels=max_pixels,
            fps=parse_fps(fps),
            start_number=start_number,
        ),
        workers=workers,
        stdin=sys.stdin.buffer if file == STDIO and sys.stdin else None,
        stdout=sys.stdout.buffer if to_stdout and sys.stdout else None,
    )
    for warning in () if quiet else camera.warnings:
        console.warn(warning)
    result: VideoResult | FailedInput
    try:
        refuse_for_frames(context, file)
        with show_progress(silent=quiet or as_json) as progress:
            result = job.video(request, progress)
    except (InputError, OutputError) as error:
        result = FailedInput(safe_name(file), error)
    from depthcli.cli.screen.results import print_video  # its imports are loaded by now

    print_video(result, as_json=as_json, quiet=quiet, to_stderr=to_stdout)
    is_whole = not isinstance(result, FailedInput) and result.problem is None
    return ExitCode.OK if is_whole else ExitCode.SOME_FAILED
