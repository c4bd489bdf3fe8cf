"""``depthcli video``: the command and its options."""

from __future__ import annotations

from typing import Annotated

import typer

from depthcli.cli import options
from depthcli.cli.numbers import not_negative
from depthcli.cli.predict_choices import ExrChannel
from depthcli.cli.video_choices import VideoFormat
from depthcli.core.choices import Upsampling
from depthcli.errors import UsageError

app = typer.Typer(rich_markup_mode=None)


@app.command()
def video(
    context: typer.Context,
    file: Annotated[str, typer.Argument(metavar="FILE", help="A video.")],
    output: Annotated[
        str | None,
        typer.Option(
            "-o",
            "--out",
            "--output",
            metavar="OUT",
            help="A .mkv or .mp4 file, or a folder (it exists, ends in '/', or has no suffix). "
            "Default: beside the video.",
        ),
    ] = None,
    formats: Annotated[
        list[VideoFormat] | None,
        typer.Option(
            "--format",
            help="What to write; repeatable: mkv (lossless 16-bit depth), mp4 (preview), png16, "
            "exr, npy (a file for each frame), json. Default: what OUT's suffix says, else mkv "
            "and mp4.",
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="PLACE", help="First frame: seconds (12.5, 1:02.5) or a frame number (300f)."
        ),
    ] = None,
    end: Annotated[
        str | None, typer.Option(metavar="PLACE", help="First frame that is left out again.")
    ] = None,
    every: Annotated[
        str | None,
        typer.Option(
            metavar="STEP", help="Take every STEP-th frame (2), or one every so often (0.5s)."
        ),
    ] = None,
    smooth: Annotated[
        float,
        typer.Option(
            callback=not_negative,
            help="Smooth depth over time, with this time constant in seconds (0.2, say), where "
            "the picture keeps still. 0: not at all.",
        ),
    ] = 0.0,
    lock: Annotated[
        float,
        typer.Option(
            callback=not_negative,
            help="Hold the preview's range steady, with this time constant in seconds. 0: each "
            "frame's own.",
        ),
    ] = 1.0,
    model: options.ModelOption = None,
    provider: options.ProviderOption = "auto",
    provider_option: options.ProviderSettingsOption = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Frames worked on at the same time. Default: one a core."),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(min=1, help="Threads of the network for one frame. Default: cores/workers."),
    ] = None,
    png_scale: options.PngScaleOption = None,
    png_normalize: options.PngNormalizeOption = False,
    exr_channel: options.ExrChannelOption = ExrChannel.Y,
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
    upsample: options.UpsampleOption = Upsampling.GUIDED,
    tile: options.TileOption = None,
    max_memory: options.MaxMemoryOption = None,
    max_pixels: options.MaxPixelsOption = options.MAX_PIXELS,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object at the end, on stdout.")
    ] = False,
    quiet: options.QuietOption = False,
) -> int:
    """Depth of every frame of a video.

    Writes lossless 16-bit video in millimetres, a preview, or a file for each frame.

    Exit code 0 if all was done, 1 if the video cannot be read to its end, 2 for wrong usage, 3 if
    the model failed.
    """
    from depthcli.cli.camera import choose_camera
    from depthcli.cli.cores import usable_cores
    from depthcli.cli.detail import choose_detail
    from depthcli.cli.engine import Engine
    from depthcli.cli.looks import choose_looks
    from depthcli.cli.unused import refuse_unused
    from depthcli.cli.video_choices import parse_span
    from depthcli.cli.video_outputs import choose_formats, plan_video

    looks = choose_looks(
        png_scale=png_scale,
        png_normalize=png_normalize,
        exr_channel=exr_channel,
        half=half,
        colormap=colormap,
        near=near,
        vmin=vmin,
        vmax=vmax,
        legend=legend,
        side_by_side=side_by_side,
    )
    choose_camera(focal_px, hfov, None)
    span = parse_span(start, end, every)
    chosen = choose_formats(output, formats or ())
    if png_normalize and {VideoFormat.MKV, VideoFormat.PNG16} <= set(chosen):
        raise UsageError("--png-normalize stretches png16, and mkv is in millimetres: give one")
    refuse_unused(context, chosen, tuple(VideoFormat))
    detail = choose_detail(upsample, tile, max_memory, chosen, side_by_side=side_by_side)
    job = plan_video(file, output, chosen, sidecar=sidecar)
    cores = usable_cores()
    at_once = workers or cores
    share = threads or max(1, cores // at_once)
    loading = Engine(model, provider, share, provider_option or ()).start()
    from depthcli.cli.video_reel import VideoSettings
    from depthcli.cli.video_tell import run_and_tell

    settings = VideoSettings(
        looks=looks,
        workers=at_once,
        span=span,
        smooth_s=smooth,
        lock_s=lock,
        focal_px=focal_px,
        hfov_deg=hfov,
        max_pixels=detail.most_pixels(max_pixels),
    )
    return run_and_tell(job, loading, settings, detail, as_json=as_json, quiet=quiet)
