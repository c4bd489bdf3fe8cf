"""``depthcli convert``: a depth file in another format, and what that costs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from depthcli.cli import console
from depthcli.cli.depth_input import FrameOption, read_map
from depthcli.cli.numbers import positive
from depthcli.cli.predict_choices import ExrChannel, Format
from depthcli.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from depthcli.core.types import DepthMap
    from depthcli.io.writers.base import Writer

app = typer.Typer(rich_markup_mode=None)

_MILLIMETRES = 1000.0
_READABLE = (Format.PNG16, Format.EXR, Format.NPY)


@app.command()
def convert(
    source: Annotated[
        str, typer.Argument(metavar="IN", help="16-bit PNG, EXR, NPY, or a depth video (.mkv).")
    ],
    target: Annotated[
        str, typer.Argument(metavar="OUT", help="A file; its suffix says the format.")
    ],
    format_: Annotated[
        Format | None, typer.Option("--format", help="The format, where the suffix does not say.")
    ] = None,
    from_scale: Annotated[
        float | None,
        typer.Option(
            callback=positive,
            help="Steps a metre in a PNG or video that is read. Default: what it states, or 1000.",
        ),
    ] = None,
    frame: FrameOption = None,
    png_scale: Annotated[
        float, typer.Option(callback=positive, help="Steps a metre in a PNG that is written.")
    ] = _MILLIMETRES,
    png_normalize: Annotated[
        bool, typer.Option("--png-normalize", help="Stretch a PNG to 1-65535; no unit.")
    ] = False,
    exr_channel: Annotated[
        ExrChannel, typer.Option(help="Name of the channel in EXR.")
    ] = ExrChannel.Z,
    half: Annotated[bool, typer.Option("--half", help="16-bit floats in EXR.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")] = False,
) -> int:
    """Convert a depth file, and report the error of reading it back."""
    from depthcli.io.atomic import atomic_path
    from depthcli.io.depth_files import read_depth
    from depthcli.io.naming import is_folder
    from depthcli.io.writers.registry import writer_class

    if target == "-" or is_folder(target):
        raise UsageError(f"{target} is no file; name one, {target.rstrip('/')}/depth.exr say")
    chosen = _format(target, format_)
    options: dict[Format, dict[str, object]] = {
        Format.PNG16: {"scale": png_scale, "normalize": png_normalize},
        Format.EXR: {"channel": exr_channel.value, "half": half},
    }
    writer: Writer = writer_class(chosen)(**options.get(chosen, {}))
    depth = read_map(Path(source), scale=from_scale, frame=frame)
    with atomic_path(Path(target), inputs=(Path(source),)) as temporary:
        warnings = writer.write(depth, temporary)
        again = read_depth(temporary) if chosen in _READABLE else None
    facts = {
        "input": source,
        "output": target,
        "unit": "m" if depth.is_metric else None,
        **_error(depth, again),
        "warnings": list(warnings),
    }
    _tell(facts, as_json=as_json, quiet=quiet)
    return ExitCode.OK


def _format(target: str, asked: Format | None) -> Format:
    from depthcli.cli.predict_outputs import FORMAT_OF_SUFFIX

    found = asked or FORMAT_OF_SUFFIX.get(Path(target).suffix.lower())
    if found is None:
        known = ", ".join(FORMAT_OF_SUFFIX)
        raise UsageError(f"{target} says no format; end it in {known}, or give --format")
    return found


def _error(depth: DepthMap, again: DepthMap | None) -> dict[str, object]:
    """How far what is read back is from what was written, in the map's unit."""
    import numpy as np

    if again is None:
        return {"max_error": None, "mean_error": None, "lost": None}
    here, there = np.isfinite(depth.values), np.isfinite(again.values)
    both = here & there
    gap = np.abs(depth.values[both].astype(np.float64) - again.values[both])
    return {
        "max_error": float(gap.max()) if gap.size else 0.0,
        "mean_error": float(gap.mean()) if gap.size else 0.0,
        "lost": int((here & ~there).sum()),
    }


def _tell(facts: dict[str, object], *, as_json: bool, quiet: bool) -> None:
    if as_json:
        console.out_json(facts)
        return
    if quiet:
        return
    line = f"{facts['input']} -> {facts['output']}"
    if facts["max_error"] is not None:
        unit = f" {facts['unit']}" if facts["unit"] else ""
        line += (
            f"  round trip: max error {facts['max_error']:.3g}{unit}, "
            f"mean {facts['mean_error']:.3g}{unit}, {facts['lost']} pixels lost"
        )
    console.out(console.one_line(line))
    warnings = facts["warnings"]
    for warning in warnings if isinstance(warnings, list) else ():
        console.warn(warning)
