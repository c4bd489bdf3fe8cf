"""The documentation knows every command and option."""

from __future__ import annotations

from pathlib import Path

import pytest

from depthcli.cli import shell
from depthcli.cli.app import COMMANDS

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_in_the_documentation(name: str) -> None:
    text = "".join(path.read_text() for path in DOCS.glob("*.md"))
    pending = [shell.load_command(name)]
    while pending:
        command = pending.pop()
        pending.extend(getattr(command, "commands", {}).values())
        own = [p for p in command.params if p.expose_value or command.name != "save"]
        for parameter in own:  # what a profile saves is documented with its own command
            for option in parameter.opts:
                assert not option.startswith("-") or f"`{option}" in text, option


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_in_the_documentation(name: str) -> None:
    text = "".join(path.read_text() for path in DOCS.glob("*.md"))
    assert f"depthcli {name}" in text
