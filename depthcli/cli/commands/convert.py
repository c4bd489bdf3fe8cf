"""``depthcli convert``: converting depth files, and the round-trip error."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from depthcli.cli import options
from depthcli.cli.checks import FrameOption
from depthcli.cli.options import field_of_view, focal_length, png_scale_range
from depthcli.cli.screen import console
from depthcli.errors import ExitCode, UsageError
from depthcli.io.formats.table import Format

if TYPE_CHECKING:
    from depthcli.core.camera import Intrinsics
    from depthcli.io.formats.table import WriterOptions

app = typer.Typer(rich_markup_mode=None)


@app.command()
def convert(
    context: typer.Context,
    source: Annotated[
        str,
        typer.Argument(
            metavar="IN",
            help="Input: 16-bit PNG, EXR, NPY or depth video (.mkv); or, with --out, a folder or "
            "URI, searched recursively.",
        ),
    ],
    target: Annotated[
        str | None,
        typer.Argument(
            metavar="[OUT]",
            help="Output file; its suffix selects the format. A pattern such as depth.%04d.exr "
            "converts all frames of a depth video.",
        ),
    ] = None,
    output: Annotated[
        str | None,
        typer.Option(
            "-o",
            "--out",
            "--output",
            metavar="DIR",
            help="Output folder for a folder of depth files; keeps its structure.",
        ),
    ] = None,
    format_: Annotated[
        Format | None,
        typer.Option(
            "--format",
            help="Output format; required for a folder, else if the suffix does not determine it.",
        ),
    ] = None,
    include: Annotated[
        list[str] | None,
        typer.Option(
            metavar="GLOB",
            help="Of a folder, convert only matching files ('*.exr', 'left/**'); repeatable.",
        ),
    ] = None,
    exclude: Annotated[
        list[str] | None,
        typer.Option(
            metavar="GLOB", help="Of a folder, skip matching files and folders; repeatable."
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=1024,
            help="Files of a folder, or frames of a video, converted in parallel. Default: one "
            "per core.",
        ),
    ] = None,
    from_scale: Annotated[
        float | None,
        typer.Option(
            callback=png_scale_range,
            help="Units per metre of a PNG or video (default: from the file, else 1000), or NPY "
            "of integers.",
        ),
    ] = None,
    frame: FrameOption = None,
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
    # Unlike those of predict, they do not scale depth.
    focal_px: Annotated[
        float | None,
        typer.Option(
            callback=focal_length,
            help="Focal length in pixels, for point clouds and for the metadata of the outputs; "
            "depth stays as it is. Default: what the input states.",
        ),
    ] = None,
    hfov: Annotated[
        float | None,
        typer.Option(
            callback=field_of_view,
            help="Horizontal field of view in degrees, instead of --focal-px.",
        ),
    ] = None,
    centre_px: options.CentrePxOption = None,
    calibration: options.CalibrationOption = None,
    rectified: options.RectifiedOption = False,
    picture: Annotated[
        str | None,
        typer.Option(
            metavar="IMG",
            help="Picture of the same size, for the colours of a point cloud or --side-by-side.",
        ),
    ] = None,
    white_level: options.WhiteLevelOption = None,
    exposure: options.ExposureOption = 0.0,
    layer: options.LayerOption = None,
    as_json: options.JsonOption = False,
    quiet: options.QuietOption = False,
) -> int:
    """Convert a depth file, depth video or folder of them, and report the round-trip error.

    Exit codes: 0 success, 1 some inputs failed, 2 usage error.
    """
    from depthcli.cli.checks import USED_OPTIONS, check_arguments, folder_format, refuse_unused
    from depthcli.cli.parse import choose_camera, read_options, refuse_replacing, writer_options
    from depthcli.core.parallel import share_cores
    from depthcli.jobs import convert as job
    from depthcli.jobs.convert import convert_video, is_sequence_name

    check_arguments(context)
    chosen = folder_format(format_) if target is None else job.target_format(target, format_)
    refuse_unused(context, (chosen,), USED_OPTIONS)
    if chosen is Format.PREVIEW and side_by_side != (picture is not None):
        raise UsageError("a preview needs both --side-by-side and --picture, or neither")
    if picture is None and (white_level is not None or exposure or layer is not None):
        raise UsageError("--white-level, --exposure and --layer are for --picture; give it as well")
    refuse_replacing(calibration, target)
    camera = choose_camera(context.params)
    writing = writer_options(context.params)
    for warning in () if quiet else camera.warnings:
        console.warn(warning)
    if target is None:
        return _convert_folder(context.params, chosen, camera, writing)
    from depthcli.cli.screen.results import print_conversion, print_frames

    request = job.ConvertRequest(
        source=source,
        target=target,
        format=chosen,
        scale=from_scale,
        frame=frame,
        camera=camera,
        reading=read_options(context.params),
        picture=picture,
        writing=writing,
    )
    if is_sequence_name(target, source):
        frames = convert_video(request, share_cores(workers)[0])
        print_frames(frames, as_json=as_json, quiet=quiet)
    else:
        print_conversion(job.convert(request), as_json=as_json, quiet=quiet)
    return ExitCode.OK


def _convert_folder(
    given: dict[str, Any], chosen: Format, camera: Intrinsics, writing: WriterOptions
) -> int:
    from depthcli.cli.screen.results import FolderScreen
    from depthcli.core.parallel import share_cores
    from depthcli.io.listing.folder import NameFilter
    from depthcli.jobs.convert import ConvertFolderRequest, convert_folder, plan_conversion

    request = ConvertFolderRequest(
        root=given["source"],
        out=given["output"],
        format=chosen,
        wanted=NameFilter.of(given["include"] or (), given["exclude"] or ()),
        scale=given["from_scale"],
        camera=camera,
        writing=writing,
        workers=share_cores(given["workers"])[0],
    )
    plan = plan_conversion(request)
    screen = FolderScreen(as_json=given["as_json"], quiet=given["quiet"])
    failed = screen.run(convert_folder(request, plan), plan)
    return ExitCode.SOME_FAILED if failed else ExitCode.OK
