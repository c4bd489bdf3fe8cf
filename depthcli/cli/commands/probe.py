"""``depthcli probe``: depth at given pixels."""

import typer

from depthcli.cli.groups import Command, grouped
from depthcli.cli.options import (
    DepthFileOptions,
    FileArgument,
    JsonOption,
    StatedCameraOptions,
)
from depthcli.cli.screen import console
from depthcli.errors import ExitCode

app = typer.Typer(rich_markup_mode=None)


@app.command(cls=Command)
@grouped
def probe(
    file: FileArgument,
    pixels: list[str] = typer.Argument(
        ..., metavar="X,Y...", help="Pixel column and row, from 0 at the top left."
    ),
    *,
    depth_file: DepthFileOptions,
    camera: StatedCameraOptions,
    as_json: JsonOption = False,
) -> int:
    """Show the depth at one or several pixels of a depth file."""
    from depthcli.cli import parse
    from depthcli.io.storage.paths import path_of
    from depthcli.jobs.inspect import depth_at, read_map

    places = [parse.pixel(word) for word in pixels]
    options = parse.depth_reading(depth_file, parse.camera(camera))
    stored = read_map(path_of(file), options)
    depth = stored.displayed
    values = [depth_at(depth, x, y) for x, y in places]
    for warning in stored.warnings_with_scale("from_scale"):
        console.warn(warning)
    unit = depth.unit
    for (x, y), value in zip(places, values, strict=True):
        if as_json:
            console.out_json({"x": x, "y": y, "depth": value, "unit": unit})
        else:
            console.out(f"{x},{y}  {'no depth' if value is None else _depth_text(value, unit)}")
    return ExitCode.OK


def _depth_text(value: float, unit: str | None) -> str:
    return f"{value:.4g} {unit}" if unit else f"{value:.6g} (no unit)"
