"""Write docs/cli.md, the whole command line on one page, from the commands themselves.

Run ``python docs/write_cli.py`` after any change of a command, an option or its help.
"""

from __future__ import annotations

import enum
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.cli import shell
from depthcli.cli.groups import USUAL
from depthcli.cli.table import COMMANDS, help_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

PAGE = Path(__file__).with_name("cli.md")
EVERYWHERE = "`--debug`"  #: an option of all commands
HEAD = """\
<!-- Written by docs/write_cli.py; change the help of the command in place of this page. -->

# The whole command line

What `--help` shows, to look up a command or an option. [usage.md](usage.md) explains their use.
All commands have `--debug` and `--help`.

```
{root}```
"""


def page() -> str:
    """The page's text; options of several commands are described once."""
    commands = {name: shell.load_command(name) for name in COMMANDS}
    shared = of_several([own_and_inner(command) for command in commands.values()])
    parts = [part for name in COMMANDS for part in sections(name, commands[name], shared)]
    table = ["## Options of several commands", "", *grouped_items(shared.values()), ""]
    return "\n".join([HEAD.format(root=help_text()), *parts, *table])


def of_several(commands: list[list[Any]]) -> dict[str, Any]:
    """The options that stand in several of the lists, by their items."""
    items = [{item(p): p for p in each} for each in commands]
    counts = Counter(text for each in items for text in each)
    options = {text: p for each in reversed(items) for text, p in each.items()}
    return {text: options[text] for text, count in counts.items() if count > 1}


def own_and_inner(command: Any) -> list[Any]:  # noqa: ANN401 - typer's own types
    """The options of a command and of those in it."""
    inner = getattr(command, "commands", {}).values()
    return [p for each in (command, *inner) for p in shown(each) if p.param_type_name == "option"]


def shown(command: Any) -> list[Any]:  # noqa: ANN401 - typer's own types
    """The parameters of a command that its help shows."""
    return [p for p in command.params if not p.hidden]


def sections(name: str, command: Any, shared: dict[str, Any]) -> Iterator[str]:  # noqa: ANN401 - typer's own types
    """A section for a command, or for a group and for each command in it."""
    inner = getattr(command, "commands", {})
    arguments = [value(p) for p in command.params if p.param_type_name == "argument"]
    words = ["depthcli", name, *(["COMMAND"] if inner else []), "[OPTIONS]", *arguments]
    text = (command.help or "").replace("\f", "").strip()
    lines = [f"## depthcli {name}", "", f"`{' '.join(words)}`", "", text, ""]
    of_group = of_several([own_and_inner(each) for each in inner.values()])
    of_group = {text: p for text, p in of_group.items() if text not in shared}
    table = [p for p in shown(command) if item(p) not in shared] + list(of_group.values())
    lines += ["Options of several of these commands:", ""] if of_group else []
    lines += [*grouped_items(table), ""] if table else []
    others = [
        text for text in map(item, shown(command)) if text in shared and EVERYWHERE not in text
    ]
    names = ", ".join(in_short(others, shared))
    lines += [f"[Also](#options-of-several-commands) {names}.", ""] if others else []
    yield "\n".join(lines)
    for inner_name, each in inner.items():
        yield from sections(f"{name} {inner_name}", each, shared | of_group)


def in_short(items: list[str], shared: dict[str, Any]) -> Iterator[str]:
    """The names of groups that are there as a whole, and of the other options."""
    for group in dict.fromkeys(panel(shared[text]) for text in items):
        of_group = {text for text, p in shared.items() if panel(p) == group}
        if group != USUAL and of_group <= set(items):
            yield f"**{group}**"
        else:
            yield from (f"`{shared[text].opts[-1]}`" for text in items if text in of_group)


def panel(parameter: Any) -> str:  # noqa: ANN401 - typer's own types
    """The heading below which the help shows a parameter."""
    return getattr(parameter, "rich_help_panel", None) or USUAL


def grouped_items(parameters: Iterable[Any]) -> Iterator[str]:
    """The items of the parameters, each group below its heading; the usual options come first."""
    options = list(parameters)
    for group in dict.fromkeys([USUAL, *map(panel, options)]):
        items = [item(p) for p in options if panel(p) == group]
        yield from items if group == USUAL else [f"\n**{group}**\n", *items]


def item(parameter: Any) -> str:  # noqa: ANN401 - typer's own types
    """An argument or an option as an item of a list."""
    if parameter.param_type_name == "argument":
        head = f"`{value(parameter)}`"
    else:
        names = ", ".join(f"`{name}`" for name in [*parameter.opts, *parameter.secondary_opts])
        head = names if parameter.is_flag else f"{names} `{value(parameter)}`"
    found = default(parameter)
    return f"- {head}: {parameter.help or ''}{found and f' ({found})'}"


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
        return ", or ".join(filter(None, ["required" if parameter.required else "", variable]))
    if found is True:
        return "default: on"
    return f"default: `{found.value if isinstance(found, enum.Enum) else found}`"


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
