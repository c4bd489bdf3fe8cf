"""``depthcli info``, ``probe`` and ``view``: what a depth file holds."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import typer

from depthcli.cli import options as groups
from depthcli.cli.screen import console
from depthcli.core.options import one_line
from depthcli.errors import ExitCode, Message
from depthcli.io.formats.table import Format, SurfaceOptions, WriterOptions, stem_of

if TYPE_CHECKING:
    from depthcli.jobs.inspect import AreaDepth, PixelDepth

_SCALE_SOURCES = {
    "file": "as the file or its sidecar states",
    "option": "--from-scale",
    "assumed": "assumed; --from-scale sets another",
}


def info(
    file: groups.FileArgument,
    *,
    depth_file: groups.DepthFileOptions,
    camera: groups.StatedCameraOptions,
    as_json: groups.JsonOption = False,
) -> int:
    """Show unit, scale, size, range and model of a depth file."""
    from depthcli.cli import parse
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
    file: groups.FileArgument,
    places: list[str] = typer.Argument(
        ...,
        metavar="PLACE...",
        help="Pixel X,Y (column and row, from 0 at the top left); box X0,Y0,X1,Y1 (X1 and Y1 "
        "excluded); or mask: an image of the same size, whose pixels above 0 count.",
    ),
    *,
    depth_file: groups.DepthFileOptions,
    camera: groups.StatedCameraOptions,
    as_json: groups.JsonOption = False,
) -> int:
    """Show depth at pixels of a depth file, or its spread in boxes and masks.

    Where the camera is known, also the point in metres (x right, y down, z ahead), the normal, and
    the width and height of a box at its median depth.
    """
    from depthcli.cli import parse
    from depthcli.core.types import with_camera
    from depthcli.io.formats.geometry import camera_of
    from depthcli.io.storage.paths import path_of
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


def _text(value: "PixelDepth | AreaDepth", unit: str | None) -> str:
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
    file: groups.FileArgument,
    image: str | None = typer.Argument(
        None, metavar="[IMAGE]", help="Image of FILE, for colours (else a preview's) and camera."
    ),
    *,
    out: str | None = typer.Option(
        None, "-o", "--out", metavar="OUT", help="Output .html file. Default: next to FILE."
    ),
    is_opened: bool = typer.Option(False, "--open", help="Open the page in the browser."),
    overwrite: groups.OverwriteOption = False,
    depth_file: groups.DepthFileOptions,
    surface: SurfaceOptions,
    camera: groups.StatedCameraOptions,
    read: groups.ReadOptions,
    screen: groups.ScreenOptions,
) -> int:
    """Show a depth file in three dimensions.

    Writes a page, which needs no network, with a grid in metres, the depth at the pointer, and the
    distance between two points.

    Exit codes: 0 success, 1 the file cannot be shown, 2 usage error.
    """
    from depthcli.cli import parse
    from depthcli.cli.screen.results import print_conversion
    from depthcli.io.storage.paths import path_of
    from depthcli.jobs.convert import ConvertRequest, convert

    place = path_of(file)
    seen_by = parse.camera(camera)
    request = ConvertRequest(
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
    result = convert(request)
    print_conversion(result, screen)
    if is_opened:
        import webbrowser

        if not webbrowser.open(path_of(result.target).resolve().as_uri()):
            console.warn(f"no browser was found; open {result.target} in one")
    return ExitCode.OK
