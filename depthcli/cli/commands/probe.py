"""``depthcli probe``: depth at given pixels, in boxes and masks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from depthcli.cli import options as groups
from depthcli.cli.screen import console
from depthcli.core.options import one_line
from depthcli.errors import ExitCode

if TYPE_CHECKING:
    from depthcli.jobs.inspect import AreaDepth


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
    """Show the depth at pixels of a depth file, or its spread in boxes and masks."""
    from depthcli.cli import parse
    from depthcli.io.storage.paths import path_of
    from depthcli.jobs.inspect import AreaDepth, depth_at, depth_in, read_map, read_mask

    areas = [parse.area(word) for word in places]
    options = parse.depth_reading(depth_file, parse.camera(camera))
    stored = read_map(path_of(file), options)
    depth = stored.displayed
    depths: list[float | AreaDepth | None] = []
    for area in areas:
        match area:
            case (x, y):
                depths.append(depth_at(depth, x, y))
            case (left, top, right, bottom):
                depths.append(depth_in(depth, (left, top, right, bottom)))
            case _:
                depths.append(depth_in(depth, read_mask(str(area))))
    for warning in stored.warnings_with_scale("from_scale"):
        console.warn(warning)
    unit = depth.unit
    for word, area, value in zip(places, areas, depths, strict=True):
        name = word if isinstance(area, str) else ",".join(map(str, area))
        if not as_json:
            console.out(one_line(f"{name}  {_text(value, unit)}"))
        elif isinstance(value, AreaDepth):
            shares = {"pixels": value.pixels, "without_depth": value.without_depth}
            console.out_json({"area": name, **shares, **value.quantiles, "unit": unit})
        else:
            console.out_json({"x": area[0], "y": area[1], "depth": value, "unit": unit})
    return ExitCode.OK


def _text(value: float | AreaDepth | None, unit: str | None) -> str:
    if value is None:
        return "no depth"
    if isinstance(value, float):
        return f"{value:.4g} {unit}" if unit else f"{value:.6g} (no unit)"
    if value.quantiles["median"] is None:
        return f"no depth in {value.pixels} pixels"
    values = (f"{k} {v:.4g}" for k, v in value.quantiles.items() if v is not None)
    return (
        f"{', '.join(values)} {unit or '(no unit)'} in {value.pixels} pixels, "
        f"{value.without_depth:.1%} without depth"
    )
