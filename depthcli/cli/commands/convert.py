"""``depthcli convert``: converting depth files, and the round-trip error."""

from __future__ import annotations

from dataclasses import fields

import typer

from depthcli.cli import options as groups
from depthcli.cli.groups import Given, group
from depthcli.core.options import DepthEncoding
from depthcli.errors import ExitCode, UsageError
from depthcli.io.formats.table import FORMATS, Format, WriterOptions
from depthcli.video.formats import VIDEOS, VideoFormat, video_format_of


@group
class InputOptions:
    """Input."""

    image: str | None = groups.option(
        "Image of the same size, for colours, and for the camera if IN states none.", metavar="IMG"
    )
    include: list[str] | None = groups.option(
        "In a folder, convert only matching files ('*.exr', 'left/**'); repeatable.", metavar="GLOB"
    )
    exclude: list[str] | None = groups.option(
        "In a folder, skip matching files and folders; repeatable.", metavar="GLOB"
    )
    fps: str | None = groups.option(
        "Frames per second of numbered files. Default: as the files state, else 25.", metavar="RATE"
    )


_OF_CAMERA = (DepthEncoding.DISTANCE, DepthEncoding.DISPARITY)
_CAMERA = tuple(field.name for field in fields(groups.CameraOptions))


def _options_of(name: Format) -> tuple[str, ...]:
    """The options that a format uses, by parameter name."""
    camera = _CAMERA if name.facts.has_camera else ()
    image = ["image"] if name.facts.shows_image else []
    return (*name.facts.options, *camera, *image)


FORMAT_OPTIONS = {str(name): _options_of(name) for name in FORMATS}
FORMAT_OPTIONS |= {str(name): name.facts.options for name in VIDEOS}
"""The options that each format uses, by parameter name."""


def convert(
    source: str = typer.Argument(
        ...,
        metavar="IN",
        help="Input: 16-bit PNG or PGM, EXR, NPY, NPZ, PFM, TIFF, COLMAP's .bin, depth video "
        "(.mkv), numbered files (depth.%04d.exr), or a folder or URI, which is "
        "searched recursively.",
    ),
    target: str | None = typer.Argument(
        None,
        metavar="[OUT]",
        help="Output file, whose suffix selects the format; for all frames of a video or sequence "
        "a pattern (depth.%04d.exr), lossless .mkv, or preview .mp4, .webm, .mov; or a folder, if "
        "IN is one.",
    ),
    out: str | None = typer.Option(
        None, "-o", "--out", metavar="OUT", help="Output, as the argument OUT."
    ),
    form: Format | None = typer.Option(
        None,
        "--format",
        help="Output format; required for a folder, or if the suffix does not determine it.",
    ),
    *,
    overwrite: groups.OverwriteOption = False,
    depth_file: groups.DepthFileOptions,
    inputs: InputOptions,
    workers: groups.WorkersOption = None,
    camera: groups.StatedCameraOptions,
    read: groups.ReadOptions,
    writing: WriterOptions,
    screen: groups.ScreenOptions,
    explicit: Given,
) -> int:
    """Convert a depth file, depth video, sequence or folder, and report the round-trip error.

    Exit codes: 0 success, 1 some inputs failed, 2 usage error.
    """
    from depthcli.cli import parse
    from depthcli.cli.screen.results import print_conversion, print_conversions
    from depthcli.core.parallel import share_cores
    from depthcli.io.storage.paths import path_of, safe_name
    from depthcli.jobs import convert as job
    from depthcli.video.numbering import is_pattern, is_sequence

    if (target is None) == (out is None):
        raise UsageError(f"name one output: depthcli convert {safe_name(source)} OUT")
    output = target or out or ""
    video_format = None if form else video_format_of(output)
    as_video = video_format if video_format in VIDEOS else None
    is_many = as_video is None and is_sequence(source)
    is_numbered = is_pattern(path_of(output).name)
    is_folder = is_many and not is_numbered and path_of(source).is_dir()
    if is_folder and form is None:
        raise UsageError("", "name the format of the outputs with {format}, for example exr")
    format_: Format | VideoFormat | None = as_video or (form if is_folder else None)
    format_ = format_ or job.target_of(output, form)[0]
    if format_ is Format.PREVIEW and writing.side_by_side != (inputs.image is not None):
        raise UsageError("", "give both {side_by_side} and {image}, or neither")
    parse.refuse_alternatives(vars(writing))
    seen_by = parse.camera(camera)
    of_camera = _CAMERA if depth_file.from_kind in _OF_CAMERA else ()
    written = {name: word for name, word in explicit.items() if name not in of_camera}
    unused = parse.unused_by_outputs(written, [format_], writing, used_by=FORMAT_OPTIONS)
    screen.warn_all([*seen_by.warnings, *unused])
    count = share_cores(workers)[0]
    request = job.ConvertRequest(
        source=source,
        target=output,
        format=form,
        stated=parse.depth_reading(depth_file, seen_by),
        camera=seen_by,
        reading=parse.reading(read),
        image=inputs.image,
        writing=writing,
        overwrite=overwrite,
        fps=None if inputs.fps is None else parse.fps(inputs.fps),
    )
    if is_many:
        from depthcli.io.listing import NameFilter

        names = NameFilter.of(inputs.include or (), inputs.exclude or ())
        plan = job.plan_folder(request, names) if is_folder else job.plan_sequence(request)
        converted = job.convert_folder(request, plan, count)
        failed = print_conversions(converted, "files", screen, plan)
        return ExitCode.SOME_FAILED if failed else ExitCode.OK
    if as_video is not None:
        warnings: list[str] = []
        print_conversions(job.convert_to_video(request, as_video, warnings), "frames", screen)
        screen.warn_all(warnings)
    elif is_numbered:
        print_conversions(job.convert_video(request, count), "frames", screen)
    else:
        print_conversion(job.convert(request), screen)
    return ExitCode.OK
