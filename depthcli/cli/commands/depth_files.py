"""``depthcli convert``, ``info``, ``probe`` and ``view``: the commands on depth files."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any

import typer

from depthcli.cli import groups, options, parse
from depthcli.cli.screen import console
from depthcli.core.options import DepthEncoding, one_line
from depthcli.errors import ExitCode, Message, UsageError
from depthcli.io.formats.table import FORMATS, Format, SurfaceOptions, WriterOptions, stem_of
from depthcli.io.storage.paths import path_of, safe_name
from depthcli.video.formats import VIDEOS, VideoFormat, video_format_of

if TYPE_CHECKING:
    from depthcli.jobs.inspect import AreaDepth, PixelDepth


@groups.group
class InputOptions:
    """Input."""

    image: str | None = options.option(
        "Image of the same size, for colours, and for the camera if IN states none.", metavar="IMG"
    )
    include: list[str] | None = options.option(
        "In a folder, convert only matching files ('*.exr', 'left/**'); repeatable.", metavar="GLOB"
    )
    exclude: list[str] | None = options.option(
        "In a folder, skip matching files and folders; repeatable.", metavar="GLOB"
    )
    fps: str | None = options.option(
        "Frames per second of numbered files. Default: as the files state, else 25.", metavar="RATE"
    )


_OF_CAMERA = (DepthEncoding.DISTANCE, DepthEncoding.DISPARITY)
_CAMERA = tuple(field.name for field in fields(options.CameraOptions))


FORMAT_OPTIONS = {
    str(name): (
        *facts.options,
        *(_CAMERA if facts.has_camera else ()),
        *(["image"] if facts.shows_image else ()),
    )
    for name, facts in FORMATS.items()
}
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
    overwrite: options.OverwriteOption = False,
    depth_file: options.DepthFileOptions,
    inputs: InputOptions,
    workers: options.WorkersOption = None,
    camera: options.StatedCameraOptions,
    read: options.ReadOptions,
    writing: WriterOptions,
    screen: options.ScreenOptions,
    explicit: groups.Given,
) -> int:
    """Convert a depth file, depth video, sequence or folder, and report the round-trip error.

    Exit codes: 0 success, 1 some inputs failed, 2 usage error.
    """
    from depthcli.cli.screen.results import print_conversion, print_conversions
    from depthcli.core.parallel import share_cores
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


_SCALE_SOURCES = {
    "file": "as the file or its sidecar states",
    "option": "--from-scale",
    "assumed": "assumed; --from-scale sets another",
}


def info(
    file: options.FileArgument,
    *,
    depth_file: options.DepthFileOptions,
    camera: options.StatedCameraOptions,
    as_json: options.JsonOption = False,
) -> int:
    """Show unit, scale, size, range and model of a depth file."""
    from depthcli.jobs.inspect import inspect_file

    facts = inspect_file(file, parse.depth_reading(depth_file, parse.camera(camera)))
    warnings: Any = facts.get("warnings", ())
    if as_json:
        texts = [console.worded(warning) for warning in warnings]
        console.out_json(facts | ({"warnings": texts} if "warnings" in facts else {}))
    else:
        console.warn_all(warnings)
        _show({name: value for name, value in facts.items() if name != "warnings"})
    return ExitCode.OK


def _show(facts: dict[str, Any]) -> None:
    source = facts.pop("scale_source")
    facts["scale"] = source and f"{facts['scale']:g} per metre ({_SCALE_SOURCES[source]})"
    for name in ("scale", "channel"):
        if facts.get(name) is None:
            facts.pop(name, None)
    facts |= {f"metadata {name}": value for name, value in facts.pop("metadata").items()}
    width = max(map(len, facts))
    for name, value in facts.items():
        text = f"{value:.6g}" if isinstance(value, float) else value
        console.out(one_line(f"{name:<{width}}  {'none' if text is None else text}"))


def probe(
    file: options.FileArgument,
    places: list[str] = typer.Argument(
        ...,
        metavar="PLACE...",
        help="Pixel X,Y (column and row, from 0 at the top left); box X0,Y0,X1,Y1 (X1 and Y1 "
        "excluded); or mask: an image of the same size, whose pixels above 0 count.",
    ),
    *,
    depth_file: options.DepthFileOptions,
    camera: options.StatedCameraOptions,
    as_json: options.JsonOption = False,
) -> int:
    """Show depth at pixels of a depth file, or its spread in boxes and masks.

    Where the camera is known, also the point in metres (x right, y down, z ahead), the normal, and
    the width and height of a box at its median depth.
    """
    from depthcli.core.types import with_camera
    from depthcli.io.formats.geometry import camera_of
    from depthcli.jobs.inspect import AreaDepth, depth_at, depth_in, read_map, read_mask

    areas = [parse.area(word) for word in places]
    lens = parse.camera(camera)
    stored = read_map(path_of(file), parse.depth_reading(depth_file, lens))
    depth = with_camera(stored.displayed, lens)
    depths: list[PixelDepth | AreaDepth] = []
    for area in areas:
        match area:
            case (x, y):
                depths.append(depth_at(depth, x, y))
            case (left, top, right, bottom):
                depths.append(depth_in(depth, (left, top, right, bottom)))
            case _:
                depths.append(depth_in(depth, read_mask(str(area))))
    console.warn_all(stored.warnings_with_scale("from_scale"))
    if depth.is_metric and depth.provenance.focal_px:
        console.warn_all(camera_of(depth)[1])
    unit = depth.unit
    for word, area, value in zip(places, areas, depths, strict=True):
        name = word if isinstance(area, str) else ",".join(map(str, area))
        facts = asdict(value) | {"unit": unit}
        place = {"x": area[0], "y": area[1]}
        if isinstance(value, AreaDepth):
            place = {"area": name, **facts.pop("quantiles")}
        console.show(place | facts, f"{name}  {_text(value, unit)}", as_json=as_json)
        if isinstance(value, AreaDepth) and value.is_on_edge:
            problem = "the box holds a near and a far surface, so its median may be of neither"
            console.warn(Message(problem, "make it smaller, or give a mask").about(name))
    return ExitCode.OK


def _text(value: PixelDepth | AreaDepth, unit: str | None) -> str:
    from depthcli.jobs.inspect import PixelDepth

    if isinstance(value, PixelDepth):
        if value.depth is None:
            return "no depth"
        text = f"{value.depth:.4g} {unit}" if unit else f"{value.depth:.6g} (no unit)"
        text += "" if value.error is None else f" ± {value.error:.0%}"
        vectors = {"point": value.point_m, "normal": value.normal}
        each = (f"  {name} {v[0]:.3f},{v[1]:.3f},{v[2]:.3f}" for name, v in vectors.items() if v)
        return text + "".join(each)
    if value.quantiles["median"] is None:
        return f"no depth in {value.pixels} pixels"
    values = (f"{k} {v:.4g}" for k, v in value.quantiles.items() if v is not None)
    size = (
        f", {value.size_m[0]:.3g} × {value.size_m[1]:.3g} m wide and high" if value.size_m else ""
    ) + ("" if value.error is None else f", expected error {value.error:.0%}")
    return (
        f"{', '.join(values)} {unit or '(no unit)'} in {value.pixels} pixels, "
        f"{value.without_depth:.1%} without depth{size}"
    )


def view(
    file: options.FileArgument,
    image: str | None = typer.Argument(
        None, metavar="[IMAGE]", help="Image of FILE, for colours (else a preview's) and camera."
    ),
    *,
    out: str | None = typer.Option(
        None, "-o", "--out", metavar="OUT", help="Output .html file. Default: next to FILE."
    ),
    is_opened: bool = typer.Option(False, "--open", help="Open the page in the browser."),
    overwrite: options.OverwriteOption = False,
    depth_file: options.DepthFileOptions,
    surface: SurfaceOptions,
    camera: options.StatedCameraOptions,
    read: options.ReadOptions,
    screen: options.ScreenOptions,
) -> int:
    """Show a depth file in three dimensions.

    Writes a page, which needs no network, with a grid in metres, the depth at the pointer, and the
    distance between two points.

    Exit codes: 0 success, 1 the file cannot be shown, 2 usage error.
    """
    from depthcli.cli.screen.results import print_conversion
    from depthcli.jobs import convert as job

    place = path_of(file)
    seen_by = parse.camera(camera)
    request = job.ConvertRequest(
        source=file,
        target=out or str(place.with_name(stem_of(place.name) + Format.HTML.facts.suffix)),
        format=Format.HTML,
        stated=parse.depth_reading(depth_file, seen_by),
        camera=seen_by,
        reading=parse.reading(read),
        image=image,
        writing=WriterOptions(**asdict(surface)),
        overwrite=overwrite,
    )
    screen.warn_all(seen_by.warnings)
    result = job.convert(request)
    print_conversion(result, screen)
    if is_opened:
        import webbrowser

        if not webbrowser.open(path_of(result.target).resolve().as_uri()):
            console.warn(f"no browser was found; open {result.target} in one")
    return ExitCode.OK
