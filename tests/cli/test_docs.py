"""The pages of commands, and the table of what each does."""

import dataclasses
import json
import re
import runpy
import shlex
from pathlib import Path

import pytest

from depthcli.cli import shell
from depthcli.cli.table import COMMANDS
from depthcli.lab.training.settings import resolve_config
from depthcli.models.catalog import ready_names
from docs import write_methods

DOCS = Path(__file__).resolve().parents[2] / "docs"
GENERATED = "cli.md"


def written_pages() -> str:
    """What people wrote; the generated page knows every option and says nothing of its use."""
    return "".join(path.read_text() for path in DOCS.glob("*.md") if path.name != GENERATED)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_and_option_has_help_and_is_in_the_documentation(name: str) -> None:
    text = written_pages()
    assert f"depthcli {name}" in text
    pending = [shell.load_command(name)]
    while pending:
        command = pending.pop()
        pending.extend(getattr(command, "commands", {}).values())
        assert command.help
        if not hasattr(command, "commands"):
            assert any("--debug" in parameter.opts for parameter in command.params)
        for parameter in command.params:
            assert parameter.help, parameter.name
            for option in parameter.opts:
                stated = re.search(rf"`{re.escape(option)}(?![\w-])", text)
                assert stated or not option.startswith("-"), option


def test_every_model_of_an_example_is_one() -> None:
    """A path or a word in capitals is the reader's own."""
    examples = (written_pages() + (DOCS.parent / "README.md").read_text()).splitlines()
    named = {name for line in examples for name in re.findall(r"--model ([a-z0-9-]+)(?!\S)", line)}
    bundled = {path.name for path in (DOCS.parent / "models").iterdir() if path.is_dir()}
    assert named
    assert named <= bundled | set(ready_names())


def test_generated_page_is_current() -> None:
    page = runpy.run_path(str(DOCS / "write_cli.py"))["page"]()
    current = (DOCS / GENERATED).read_text("utf-8") == page
    assert current, "docs/cli.md is not what the commands say; run: python docs/write_cli.py"


PAGE = (Path(__file__).parents[2] / "docs" / "methods.md").read_text("utf-8")
MEASURED = Path(__file__).parents[2] / "docs" / "results" / "generators"


def _commands() -> list[list[str]]:
    """The words of every `depthcli train` on the page, with its variables filled in."""
    found, values = [], {}
    for block in re.findall(r"```\n(.*?)```", PAGE, re.DOTALL):
        for line in block.replace("\\\n", " ").splitlines():
            if named := re.fullmatch(r'(\w+)="(.*)"', line):
                values[f"${named[1]}"] = named[2]
            elif line.startswith("depthcli train"):
                filled = re.sub(r"\$\w+", lambda named: values[named[0]], line)
                filled = re.sub(r"=N\b", "=69", filled)
                found.append(shlex.split(filled, comments=True)[2:])
    return found


def _alone(words: list[str]) -> list[list[str]]:
    """A command for each method that one names."""
    if "--methods" in words:
        place = words.index("--methods")
        names, rest = words[place + 1].split(","), words[:place] + words[place + 2 :]
    else:
        return [words]
    if "--seeds" in rest:
        place = rest.index("--seeds")
        rest = rest[:place] + rest[place + 2 :]
    return [[name, *rest] for name in names]


def _row(command: list[str]) -> str:
    out = Path(command[command.index("--out") + 1])
    return command[0] if out.name == "table" else re.sub(r"-seed\d$", "", out.name)


@pytest.mark.parametrize("card", sorted(MEASURED.glob("*/card.json")), ids=lambda p: p.parent.name)
def test_commands_give_the_settings_of_the_measured_generators(card: Path) -> None:
    every = [command for words in _commands() for command in _alone(words)]
    of_rows = {_row(one): one for one in every if not any("pilot" in word for word in one)}
    command = of_rows[re.sub(r"-seed\d$", "", card.parent.name)]
    settings = [command[i + 1] for i, word in enumerate(command) if word == "--set"]
    config = dataclasses.asdict(resolve_config(command[0], "paper-small", settings=settings))
    measured = json.loads(card.read_text())["training"]["config"]
    for part in ("generator", "output", "data", "loss", "optim"):
        shared = config[part].keys() & measured[part].keys()
        part_settings = json.loads(json.dumps({name: config[part][name] for name in shared}))
        assert part_settings == {name: measured[part][name] for name in shared}


def test_tables_are_written_from_the_results() -> None:
    for path, tables in write_methods.tables().items():
        text = path.read_text("utf-8")
        changed = text.replace("| **`proposed`** | ", "| **`proposed`** | .9").replace(
            "−.124", "−.1"
        )
        assert write_methods.page(changed, *tables) == text != changed
