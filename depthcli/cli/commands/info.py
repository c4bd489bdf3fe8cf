"""``depthcli info``: unit, scale, size and range of a depth file."""

from typing import Any

import typer

from depthcli.cli.options import FileArgument, JsonOption, ScaleOption
from depthcli.cli.screen import console
from depthcli.core.options import one_line
from depthcli.errors import ExitCode

_SCALE_SOURCES = {
    "file": "as the file or its sidecar states",
    "option": "--from-scale",
    "assumed": "assumed: millimetres; --from-scale sets another",
}
app = typer.Typer(rich_markup_mode=None)


@app.command()
def info(
    file: FileArgument,
    from_scale: ScaleOption = None,
    as_json: JsonOption = False,
) -> int:
    """Show unit, scale, size, range and model of a depth file."""
    from dataclasses import asdict

    from depthcli.jobs.inspect import inspect_file

    facts = asdict(inspect_file(file, from_scale))
    if as_json:
        told = [console.worded(warning) for warning in facts.get("warnings", ())]
        console.out_json(facts | ({"warnings": told} if "warnings" in facts else {}))
    else:
        console.warn_all(facts.pop("warnings", ()))
        _show(facts)
    return ExitCode.OK


def _show(facts: dict[str, Any]) -> None:
    source = facts.pop("scale_source")
    if source is None:
        facts.pop("scale")
    else:
        facts["scale"] = f"{facts['scale']:g} per metre ({_SCALE_SOURCES[source]})"
    if facts.get("channel") is None:
        facts.pop("channel", None)
    facts |= {f"metadata {name}": value for name, value in facts.pop("metadata").items()}
    width = max(map(len, facts))
    for name, value in facts.items():
        text = (
            f"{value:.6g}" if isinstance(value, float) else str("none" if value is None else value)
        )
        console.out(one_line(f"{name:<{width}}  {text}"))
