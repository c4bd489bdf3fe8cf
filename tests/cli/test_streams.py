"""Standard streams that are full, closed, or that nobody reads: one line, and a documented code."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from helpers.tiny import write_picture

from depthcli.cli.screen import console

if TYPE_CHECKING:
    from helpers.command_line import Cli

FULL, CLOSED = "No space left on device", "it is closed"
needs_full_device = pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no /dev/full")


def said(cli: Cli, words: str, streams: str) -> tuple[int, list[str]]:
    """Exit code and standard error of a command whose streams a shell leads elsewhere."""
    line = f"{shlex.join(cli.command(*words.split()))} {streams}"
    done = subprocess.run(
        ["bash", "-c", line],
        cwd=cli.folder,
        env=cli.environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    return done.returncode, done.stderr.splitlines()


@needs_full_device
@pytest.mark.parametrize(
    ("words", "streams", "reason"),
    [
        ("--help", ">/dev/full", FULL),
        ("--version", ">&-", CLOSED),
        ("predict --help", ">/dev/full", FULL),
        ("models list", ">&-", CLOSED),
        ("batch in --out out --json", ">/dev/full", FULL),
        ("predict in/a.png -o -", ">/dev/full", FULL),
        ("predict in/a.png -o -", ">&-", CLOSED),
    ],
)
def test_results_that_standard_output_does_not_take_are_an_error(
    cli: Cli, words: str, streams: str, reason: str
) -> None:
    write_picture(cli.folder / "in" / "a.png")
    code, lines = said(cli, words, streams)
    assert code == 1
    assert lines[-1].startswith("depthcli: error: ")
    assert lines[-1].endswith(f"cannot write standard output: {reason}")
    assert [line for line in lines if "error" in line] == lines[-1:]
    assert (cli.folder / "out" / "manifest.jsonl").exists() == words.startswith("batch")


def test_no_file_takes_the_place_of_a_closed_stream(cli: Cli) -> None:
    script = "import os, sys; from depthcli.cli.app import open_streams; open_streams()\n"
    script += "assert os.open(sys.argv[1], os.O_RDONLY) > 2; print('heard')"
    done = subprocess.run(
        ["bash", "-c", f"{shlex.join([sys.executable, '-c', script, __file__])} <&- >&- 2>&-"],
        env=cli.environment | {"PYTHONPATH": os.fspath(cli.site)},
        check=False,
    )
    assert done.returncode == 0


def test_control_characters_are_escaped(capsys: pytest.CaptureFixture[str]) -> None:
    console.out("a\x1b[31m\x07\tb\nc\u202e")
    console.note("\x9b2J é")
    out, err = capsys.readouterr()
    assert out == "a\\x1b[31m\\x07\tb\nc\\u202e\n"
    assert err == "\\x9b2J é\n"
