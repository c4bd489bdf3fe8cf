"""``depthcli info``: what the numbers of a depth file mean."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from depthcli.cli.arguments.frame import VIDEO_SUFFIX, check_scale
from depthcli.cli.arguments.numbers import positive
from depthcli.cli.screen import console
from depthcli.core.text import one_line
from depthcli.errors import ExitCode

app = typer.Typer(rich_markup_mode=None)


@app.command()
def info(
    file: Annotated[
        str, typer.Argument(help="Depth file: 16-bit PNG, EXR, NPY or depth video (.mkv).")
    ],
    png_scale: Annotated[
        float | None,
        typer.Option(
            callback=positive,
            help="Units per metre of a PNG or video. Default: from the file, else 1000.",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> int:
    """Show unit, scale, size, range and model of a depth file."""
    from dataclasses import asdict

    import numpy as np

    from depthcli.core.summary import DepthRange
    from depthcli.io.depth.facts import stated_facts
    from depthcli.io.depth.read import read_depth

    path = Path(file)
    check_scale(path, png_scale)
    if path.suffix.lower() == VIDEO_SUFFIX:
        from depthcli.jobs.inspect import video_facts

        return _tell(video_facts(path, png_scale), as_json=as_json)
    depth = read_depth(path, png_scale=png_scale)
    facts: dict[str, object] = {
        "file": file,
        "kind": depth.kind.value,
        "unit": "m" if depth.is_metric else None,
        "width": depth.width,
        "height": depth.height,
        "valid": int(np.isfinite(depth.values).sum()),
        **asdict(DepthRange.of(depth)),
        "metadata": stated_facts(path),
    }
    return _tell(facts, as_json=as_json)


def _tell(facts: dict[str, object], *, as_json: bool) -> int:
    if as_json:
        console.out_json(facts)
    else:
        _show(facts)
    return ExitCode.OK


def _show(facts: dict[str, object]) -> None:
    metadata = facts.pop("metadata")
    if isinstance(metadata, dict):
        facts |= {f"metadata {name}": value for name, value in metadata.items()}
    width = max(map(len, facts))
    for name, value in facts.items():
        text = (
            f"{value:.6g}" if isinstance(value, float) else str("none" if value is None else value)
        )
        console.out(one_line(f"{name:<{width}}  {text}"))
