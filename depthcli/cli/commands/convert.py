"""``depthcli convert``: converting a depth file, and the round-trip error."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli.arguments import options
from depthcli.cli.arguments.depth_file import FrameOption
from depthcli.cli.arguments.numbers import field_of_view, focal_length, png_scale_range
from depthcli.cli.screen import console
from depthcli.core.text import one_line
from depthcli.errors import ExitCode, UsageError
from depthcli.io.writers.formats import Format

if TYPE_CHECKING:
    from depthcli.jobs.convert import ConvertResult

app = typer.Typer(rich_markup_mode=None)

# Unlike those of predict, they do not scale depth.
_CLOUD_OPTIONS = ("cloud_focal_px", "cloud_hfov", "centre_px", "picture")
_NOT_READ_BACK = {"max_error": None, "mean_error": None, "lost": None}


@app.command()
def convert(
    context: typer.Context,
    source: Annotated[
        str, typer.Argument(metavar="IN", help="Input: 16-bit PNG, EXR, NPY or depth video (.mkv).")
    ],
    target: Annotated[
        str, typer.Argument(metavar="OUT", help="Output file; its suffix selects the format.")
    ],
    format_: Annotated[
        Format | None,
        typer.Option("--format", help="Output format, if the suffix does not determine it."),
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
    cloud_focal_px: Annotated[
        float | None,
        typer.Option(
            "--focal-px",
            callback=focal_length,
            help="Focal length in pixels for a point cloud; depth stays as it is. Default: what "
            "the input states.",
        ),
    ] = None,
    cloud_hfov: Annotated[
        float | None,
        typer.Option(
            "--hfov",
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
    as_json: options.JsonObjectOption = False,
    quiet: options.QuietOption = False,
) -> int:
    """Convert a depth file and report the round-trip error."""
    from depthcli.cli.arguments.camera import choose_camera
    from depthcli.cli.arguments.unused import PICTURE_OPTIONS, refuse_unused
    from depthcli.cli.arguments.writing import writer_options
    from depthcli.jobs import convert as job

    chosen = job.target_format(target, format_)
    ply, preview = str(Format.PLY), str(Format.PREVIEW)
    own_options = {ply: _CLOUD_OPTIONS, preview: (*PICTURE_OPTIONS[preview], "picture")}
    refuse_unused(context, (chosen,), PICTURE_OPTIONS | own_options)
    if chosen is Format.PREVIEW and side_by_side != (picture is not None):
        raise UsageError("a preview needs both --side-by-side and --picture, or neither")
    done = job.convert(
        job.ConvertRequest(
            source=source,
            target=target,
            format=chosen,
            scale=from_scale,
            frame=frame,
            camera=choose_camera(cloud_focal_px, cloud_hfov, None),
            picture=picture,
            writing=writer_options(context.params),
        )
    )
    if as_json:
        _print_conversion_json(done)
    elif not quiet:
        _print_conversion(done)
    return ExitCode.OK


def _print_conversion_json(done: ConvertResult) -> None:
    console.out_json(
        {
            "input": done.source,
            "output": done.target,
            "unit": "m" if done.depth.is_metric else None,
            **(dataclasses.asdict(done.round_trip) if done.round_trip else _NOT_READ_BACK),
            "warnings": list(done.warnings),
        }
    )


def _print_conversion(done: ConvertResult) -> None:
    """One line, and the warnings."""
    line, trip = f"{done.source} -> {done.target}", done.round_trip
    if trip is not None:
        unit = " m" if done.depth.is_metric else ""
        line += (
            f"  round trip: max error {trip.max_error:.3g}{unit}, "
            f"mean {trip.mean_error:.3g}{unit}, {trip.lost} pixels lost"
        )
    console.report(one_line(line))
    for warning in done.warnings:
        console.warn(warning)
