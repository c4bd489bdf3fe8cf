"""``depthcli info``: unit, scale, size and range of a depth file."""

from typing import Any

from depthcli.cli import options
from depthcli.cli.screen import console
from depthcli.core.options import one_line
from depthcli.errors import ExitCode

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
