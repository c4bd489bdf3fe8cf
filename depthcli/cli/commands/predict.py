"""``depthcli predict``: the command and its options."""

import sys
from typing import Annotated

import typer

from depthcli.cli import options
from depthcli.cli.screen import console
from depthcli.core.options import MAX_PIXELS, Upsampling
from depthcli.core.text import one_line
from depthcli.errors import ExitCode, UsageError
from depthcli.io.formats.table import Format

app = typer.Typer(rich_markup_mode=None)


@app.command()
def predict(
    context: typer.Context,
    images: Annotated[
        list[str],
        typer.Argument(metavar="IMG...", help="Input pictures or URIs; '-' reads from stdin."),
    ],
    output: Annotated[
        str | None,
        typer.Option(
            "-o",
            "--output",
            metavar="OUT",
            help="Output file (for one input), folder (existing, or ending in '/'), or '-' for "
            "stdout. Default: next to each input.",
        ),
    ] = None,
    formats: options.FormatOption = None,
    model: options.ModelOption = None,
    provider: options.ProviderOption = "auto",
    provider_option: options.ProviderSettingsOption = None,
    threads: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Threads for inference. Default: all cores.")
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
    anchor: options.AnchorOption = None,
    anchors: options.AnchorsOption = None,
    anchors_scale: options.AnchorsScaleOption = None,
    white_level: options.WhiteLevelOption = None,
    exposure: options.ExposureOption = 0.0,
    layer: options.LayerOption = None,
    upsample: options.UpsampleOption = Upsampling.GUIDED,
    tile: options.TileOption = None,
    max_pixels: options.MaxPixelsOption = MAX_PIXELS,
    as_json: options.JsonOption = False,
    quiet: options.QuietOption = False,
) -> int:
    """Estimate depth from one or more pictures.

    By default, writes a 16-bit PNG in millimetres and a preview next to each picture.

    Exit codes: 0 success, 1 some inputs failed, 2 usage error, 3 model error.
    """
    from depthcli.cli.checks import PICTURE_OPTIONS, refuse_for_pictures, refuse_unused
    from depthcli.cli.parse import (
        choose_anchors,
        choose_camera,
        choose_detail,
        read_options,
        refuse_replacing,
        session_loader,
        writer_options,
    )
    from depthcli.io.storage.paths import safe_name
    from depthcli.jobs.predict import run as job
    from depthcli.jobs.predict.plan import STDIO, picture_formats, split_own_outputs
    from depthcli.jobs.predict.request import PredictRequest

    to_stdout = output == STDIO
    if as_json and to_stdout:
        raise UsageError("-o - and --json both write to stdout; name a file with -o")
    refuse_replacing(calibration, output)
    writing = writer_options(context.params)
    camera = choose_camera(context.params)
    known = choose_anchors(anchor, anchors, anchors_scale)
    chosen = picture_formats(output, formats or ())
    written = [*chosen, Format.JSON] if sidecar else chosen
    refuse_unused(context, written, PICTURE_OPTIONS)
    detail = choose_detail(upsample, tile)
    pictures, own = split_own_outputs(images)
    refuse_for_pictures(context, pictures)
    results = job.predict(
        PredictRequest(
            pictures=tuple(pictures),
            output=output,
            formats=chosen,
            sidecar=sidecar,
            model=session_loader(model, provider, threads, provider_option),
            camera=camera,
            anchors=known,
            reading=read_options(context.params),
            writing=writing,
            detail=detail,
            max_pixels=max_pixels,
            stdin=sys.stdin.buffer if STDIO in pictures else None,
            stdout=sys.stdout.buffer if to_stdout else None,
        )
    )
    for warning in () if quiet else camera.warnings:
        console.warn(warning)
    for name in () if quiet else own:
        console.warn(f"{safe_name(name)} was written by depthcli; skipped")
    from depthcli.cli.screen.results import print_picture
    from depthcli.jobs.outputs import FailedInput

    failed = []
    for result in results:
        print_picture(result, as_json=as_json, quiet=quiet, to_stderr=to_stdout)
        if isinstance(result, FailedInput):
            failed.append(one_line(result.name) or "''")
    if failed and len(pictures) > 1:
        console.note(f"{len(failed)} of {len(pictures)} inputs failed: {', '.join(failed)}")
    return ExitCode.SOME_FAILED if failed else ExitCode.OK
