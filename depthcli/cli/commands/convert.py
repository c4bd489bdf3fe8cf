"""``depthcli convert``: a depth file in another format, and what that costs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli.arguments import options
from depthcli.cli.arguments.formats import ExrChannel
from depthcli.cli.arguments.frame import FrameOption, read_map
from depthcli.cli.arguments.numbers import field_of_view, positive
from depthcli.cli.screen import console
from depthcli.errors import ExitCode, InputError, UsageError
from depthcli.io.writers.formats import ENDINGS, MILLIMETRES, Format, format_of

if TYPE_CHECKING:
    from depthcli.core.types import DepthMap, Frame

app = typer.Typer(rich_markup_mode=None)

# Unlike those of predict, they scale no metres.
_CLOUD_OPTIONS = ("cloud_focal_px", "cloud_hfov", "picture")
_READABLE = (Format.PNG16, Format.EXR, Format.NPY)


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
            callback=positive,
            help="Units per metre of the input PNG or video. Default: from the file, else 1000.",
        ),
    ] = None,
    frame: FrameOption = None,
    png_scale: options.PngScaleOption = None,
    png_normalize: options.PngNormalizeOption = False,
    exr_channel: options.ExrChannelOption = ExrChannel.Y,
    half: options.HalfOption = False,
    cloud_focal_px: Annotated[
        float | None,
        typer.Option(
            "--focal-px",
            callback=positive,
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
    picture: Annotated[
        str | None,
        typer.Option(metavar="IMG", help="Picture of the same size that colours the point cloud."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    quiet: options.QuietOption = False,
) -> int:
    """Convert a depth file and report the round-trip error."""
    from depthcli.cli.arguments.camera import choose_camera
    from depthcli.cli.arguments.unused import PICTURE_OPTIONS, refuse_unused
    from depthcli.cli.arguments.writing import check_looks
    from depthcli.cli.screen.convert import Converted, RoundTrip
    from depthcli.io.depth.read import read_depth
    from depthcli.io.storage.atomic import atomic_path
    from depthcli.io.writers.options import WriterOptions

    chosen = _format(target, format_)
    refuse_unused(context, (chosen,), PICTURE_OPTIONS | {Format.PLY: _CLOUD_OPTIONS})
    choose_camera(cloud_focal_px, cloud_hfov, None)
    check_looks(png_scale, None, None, None, None, png_normalize=png_normalize)
    written = WriterOptions(png_scale or MILLIMETRES, png_normalize, exr_channel.value, half)
    depth = read_map(Path(source), scale=from_scale, frame=frame)
    depth = _seen_by(depth, cloud_focal_px, cloud_hfov)
    colours = None if picture is None else _colours(picture, depth)
    inputs = [Path(name) for name in (source, picture) if name is not None]
    with atomic_path(Path(target), inputs=inputs) as temporary:
        warnings = written.writer(chosen).write(depth, temporary, colours)
        again = read_depth(temporary) if chosen in _READABLE else None
    round_trip = RoundTrip() if again is None else RoundTrip.of(depth, again)
    done = Converted(source, target, depth, round_trip, warnings)
    if as_json:
        console.out_json(done.as_json())
    elif not quiet:
        done.tell()
    return ExitCode.OK


def _format(target: str, asked: Format | None) -> Format:
    from depthcli.jobs.naming import is_folder

    if target == "-" or is_folder(target):
        raise UsageError(
            f"{target} is not a file; name one, for example {target.rstrip('/')}/depth.exr"
        )
    found = asked or format_of(target)
    if found is None:
        raise UsageError(
            f"{target} says no format; end it in {', '.join(ENDINGS)}, or give --format"
        )
    return found


def _seen_by(depth: DepthMap, focal_px: float | None, hfov_deg: float | None) -> DepthMap:
    """The same depth with the camera that the options describe, in place of the stated one."""
    from dataclasses import replace

    from depthcli.core import scaling
    from depthcli.core.types import CameraSource, Provenance

    if hfov_deg is not None:
        focal_px = scaling.focal_px(hfov_deg, depth.width)
    if focal_px is None:
        return depth
    source = replace(
        depth.provenance or Provenance(), focal_px=focal_px, camera_source=CameraSource.OPTION
    )
    return replace(depth, provenance=source)


def _colours(picture: str, depth: DepthMap) -> Frame:
    from depthcli.io.pictures.read import read_image

    frame = read_image(picture)
    if (frame.width, frame.height) != (depth.width, depth.height):
        raise InputError(
            f"{picture} has {frame.width}×{frame.height} pixels and the depth "
            f"{depth.width}×{depth.height}; give the picture that the depth was made of"
        )
    return frame
