"""``depthcli convert``: converting depth files, and the round-trip error."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from depthcli.cli.arguments import options
from depthcli.cli.arguments.depth_file import FrameOption
from depthcli.cli.arguments.numbers import field_of_view, focal_length, png_scale_range
from depthcli.errors import ExitCode, UsageError
from depthcli.io.writers.formats import Format

if TYPE_CHECKING:
    from depthcli.core.camera import Camera
    from depthcli.io.writers.options import WriterOptions

app = typer.Typer(rich_markup_mode=None)

# Unlike those of predict, they do not scale depth.
_CLOUD_OPTIONS = ("focal_px", "hfov", "centre_px", "picture")
_FOLDER_OPTIONS = ("include", "exclude", "workers")
_FILE_OPTIONS = ("frame", "picture")


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
        typer.Argument(metavar="[OUT]", help="Output file; its suffix selects the format."),
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
            help="Files of a folder converted in parallel. Default: one per core.",
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
    focal_px: Annotated[
        float | None,
        typer.Option(
            callback=focal_length,
            help="Focal length in pixels for a point cloud; depth stays as it is. Default: what "
            "the input states.",
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
    picture: Annotated[
        str | None,
        typer.Option(
            metavar="IMG",
            help="Picture of the same size, for the colours of a point cloud or --side-by-side.",
        ),
    ] = None,
    as_json: options.JsonOption = False,
    quiet: options.QuietOption = False,
) -> int:
    """Convert a depth file, or a folder of them, and report the round-trip error.

    Exit codes: 0 success, 1 some inputs failed, 2 usage error.
    """
    from depthcli.cli.arguments.camera import choose_camera
    from depthcli.cli.arguments.unused import PICTURE_OPTIONS, refuse_unused
    from depthcli.cli.arguments.writing import writer_options
    from depthcli.jobs import convert as job

    _check_arguments(context)
    chosen = _folder_format(format_) if target is None else job.target_format(target, format_)
    ply, preview = str(Format.PLY), str(Format.PREVIEW)
    own_options = {ply: _CLOUD_OPTIONS, preview: (*PICTURE_OPTIONS[preview], "picture")}
    refuse_unused(context, (chosen,), PICTURE_OPTIONS | own_options)
    if chosen is Format.PREVIEW and side_by_side != (picture is not None):
        raise UsageError("a preview needs both --side-by-side and --picture, or neither")
    camera = choose_camera(context.params)
    writing = writer_options(context.params)
    if target is None:
        return _convert_folder(context.params, chosen, camera, writing)
    from depthcli.cli.screen.convert import print_conversion

    done = job.convert(
        job.ConvertRequest(
            source=source,
            target=target,
            format=chosen,
            scale=from_scale,
            frame=frame,
            camera=camera,
            picture=picture,
            writing=writing,
        )
    )
    print_conversion(done, as_json=as_json, quiet=quiet)
    return ExitCode.OK


def _check_arguments(context: typer.Context) -> None:
    """Check that the arguments are those of a file or those of a folder.

    Raises:
        UsageError: they are neither.
    """
    from depthcli.cli.arguments.unused import given_options
    from depthcli.io.storage.remote import RemotePath, path_of, safe_name

    source, target, output = (context.params[name] for name in ("source", "target", "output"))
    name, place = safe_name(source), path_of(source)
    if target is not None and output is not None:
        raise UsageError("give OUT for a file, or --out for a folder, not both")
    if output is not None and not place.is_dir():
        raise UsageError(f"{name} is not a folder; for a file, give OUT without --out")
    if output is None and not isinstance(place, RemotePath) and place.is_dir():
        raise UsageError(f"{name} is a folder; give --out DIR and --format")
    if output is None and target is None:
        raise UsageError(f"name the output: depthcli convert {name} OUT")
    unused, kind = (_FILE_OPTIONS, "file") if output is not None else (_FOLDER_OPTIONS, "folder")
    for option, word in given_options(context).items():
        if option in unused:
            raise UsageError(f"{word} is for a {kind}; remove it")


def _folder_format(given: Format | None) -> Format:
    if given is None:
        raise UsageError("name the format of the outputs, for example --format exr")
    return given


def _convert_folder(
    given: dict[str, Any], chosen: Format, camera: Camera, writing: WriterOptions
) -> int:
    from depthcli.cli.screen.convert import FolderScreen
    from depthcli.core.parallel.cores import share_cores
    from depthcli.io.listing.globs import NameFilter
    from depthcli.jobs.convert_folder import ConvertFolderRequest, convert_folder, plan_conversion

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
