"""Write docs/cli.md, the whole command line on one page, from the commands themselves.

Run ``python docs/write_cli.py`` after any change of a command, an option or its help.
"""

from __future__ import annotations

import enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.cli import shell
from depthcli.cli.groups import USUAL
from depthcli.cli.table import COMMANDS, help_text

if TYPE_CHECKING:
    from collections.abc import Iterator

PAGE = Path(__file__).with_name("cli.md")
HEAD = """\
<!-- Written by docs/write_cli.py; change the help of the command in place of this page. -->

# The whole command line

The commands and their options, as `--help` shows them, on one page. [usage.md](usage.md)
explains how to use them.

```
{root}```
"""


def page() -> str:
    """The page's text."""
    commands = (part for name in COMMANDS for part in sections(name, shell.load_command(name)))
    return "\n".join([HEAD.format(root=help_text()), *commands])


def sections(name: str, command: Any) -> Iterator[str]:  # noqa: ANN401 - typer's own types
    """A section for a command, or for a group and for each command in it."""
    inner = getattr(command, "commands", {})
    arguments = [value(p) for p in command.params if p.param_type_name == "argument"]
    words = ["depthcli", name, *(["COMMAND"] if inner else []), "[OPTIONS]", *arguments]
    rows = list(grouped_rows([p for p in command.params if not p.hidden]))
    table = ["| | | default |", "|---|---|---|", *rows] if rows else []
    text = (command.help or "").replace("\f", "").strip()
    yield "\n".join([f"## depthcli {name}\n", f"`{' '.join(words)}`\n", f"{text}\n", *table, ""])
    for inner_name, inner_command in inner.items():
        yield from sections(f"{name} {inner_name}", inner_command)


def grouped_rows(parameters: list[Any]) -> Iterator[str]:
    """The rows of the parameters, each group below its heading; the usual options come first."""
    panels = {p.name: getattr(p, "rich_help_panel", None) or USUAL for p in parameters}
    for panel in dict.fromkeys([USUAL, *panels.values()]):
        if panel != USUAL:
            yield f"| **{panel}** | | |"
        yield from (row(p) for p in parameters if panels[p.name] == panel)


def row(parameter: Any) -> str:  # noqa: ANN401 - typer's own types
    """An argument or an option as a line of a table."""
    if parameter.param_type_name == "argument":
        head = f"`{value(parameter)}`"
    else:
        names = ", ".join(f"`{name}`" for name in [*parameter.opts, *parameter.secondary_opts])
        head = names if parameter.is_flag else f"{names} `{value(parameter)}`"
    cells = [head, parameter.help or "", default(parameter)]
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def value(parameter: Any) -> str:  # noqa: ANN401 - typer's own types
    """The placeholder of what a parameter takes."""
    if parameter.metavar:
        return str(parameter.metavar)
    if parameter.param_type_name == "argument":
        name = parameter.human_readable_name.upper().strip("[]")
        return name if parameter.required else f"[{name}]"
    return "|".join(parameter.type.choices)


def default(parameter: Any) -> str:  # noqa: ANN401 - typer's own types
    """What holds without the option, if it is a plain value."""
    found = parameter.default
    if found is None or found is False or callable(found) or found in ("", (), []):
        variable = f"`${parameter.envvar}`" if parameter.envvar else ""
        return " or ".join(filter(None, [variable, "required" if parameter.required else ""]))
    if found is True:
        return "on"
    return f"`{found.value if isinstance(found, enum.Enum) else found}`"


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
