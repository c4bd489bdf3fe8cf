"""Importing commands, without the options that the shell adds."""

from collections.abc import Iterable
from importlib import import_module
from typing import Any

from typer.main import get_command

from depthcli.cli.table import COMMANDS

_COMPLETION = {"install_completion", "show_completion"}


def plain_command(name: str) -> Any:  # noqa: ANN401 - typer's own types
    """Import one command."""
    module = import_module(f"depthcli.cli.commands.{COMMANDS[name][0]}")
    command = get_command(module.app)
    command.name = name
    # Completion is installed for the program, not for each of its commands.
    command.params = [p for p in command.params if p.name not in _COMPLETION]
    if hasattr(module, "add_options"):
        module.add_options(command)
    return command


def suggestion(word: str, known: Iterable[str], help_of: str) -> str:
    """End of a message about an unknown name: a similar name, or which help to read."""
    from difflib import get_close_matches

    close = get_close_matches(word, known, n=1)
    return f"; did you mean {close[0]!r}?" if close else f"; see '{help_of} --help'"
