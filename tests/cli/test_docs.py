"""The documentation knows every command and option."""

import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from depthcli.cli import shell
from depthcli.cli.table import COMMANDS
from depthcli.models.catalog import ready_names

DOCS = Path(__file__).resolve().parents[2] / "docs"
GENERATED = "cli.md"


def written_pages() -> str:
    """What people wrote; the generated page knows every option and says nothing of its use."""
    return "".join(path.read_text() for path in DOCS.glob("*.md") if path.name != GENERATED)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_in_the_documentation(name: str) -> None:
    text = written_pages()
    pending = [shell.load_command(name)]
    while pending:
        command = pending.pop()
        pending.extend(getattr(command, "commands", {}).values())
        for parameter in command.params:
            for option in parameter.opts:
                stated = re.search(rf"`{re.escape(option)}(?![\w-])", text)
                assert stated or not option.startswith("-"), option


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_in_the_documentation(name: str) -> None:
    text = written_pages()
    assert f"depthcli {name}" in text


def test_every_model_of_an_example_is_one() -> None:
    """A path or a word in capitals is the reader's own."""
    examples = (written_pages() + (DOCS.parent / "README.md").read_text()).splitlines()
    named = {name for line in examples for name in re.findall(r"--model ([a-z0-9-]+)(?!\S)", line)}
    bundled = {path.name for path in (DOCS.parent / "models").iterdir() if path.is_dir()}
    assert named
    assert named <= bundled | set(ready_names())


def test_help_of_the_renderer_writes_nothing(tmp_path: Path) -> None:
    script = shutil.copy(DOCS / "render_room.py", tmp_path)
    done = subprocess.run([sys.executable, script, "--help"], capture_output=True, check=False)
    assert (done.returncode, done.stdout[:5]) == (0, b"usage")
    assert [path.name for path in tmp_path.iterdir()] == ["render_room.py"]


def test_generated_page_is_current() -> None:
    page = runpy.run_path(str(DOCS / "write_cli.py"))["page"]()
    current = (DOCS / GENERATED).read_text("utf-8") == page
    assert current, "docs/cli.md is not what the commands say; run: python docs/write_cli.py"
