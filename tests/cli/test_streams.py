"""Standard streams that are full, closed, or that nobody reads: one line, and a documented code."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.command_line import Cli
from helpers.tiny import write_picture

from depthcli.cli.screen import console


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no /dev/full")
@pytest.mark.parametrize(
    ("words", "stream"),
    [
        ("--help", ">/dev/full"),
        ("--version", ">&-"),
        ("batch in --out out --json", ">/dev/full"),
        ("predict in/a.png -o -", ">/dev/full"),
        ("predict in/a.png -o -", ">&-"),
    ],
)
def test_results_that_stdout_does_not_take_are_an_error(cli: Cli, words: str, stream: str) -> None:
    write_picture(cli.folder / "in" / "a.png")
    line = f"{shlex.join(cli.command(*words.split()))} {stream}"
    done = subprocess.run(
        ["bash", "-c", line],
        cwd=cli.folder,
        env=cli.environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 1
    assert "cannot write standard output" in done.stderr.splitlines()[-1]
    assert (cli.folder / "out" / "manifest.jsonl").exists() == words.startswith("batch")


def test_no_file_takes_the_place_of_a_closed_stream(cli: Cli) -> None:
    script = "import os, sys; from depthcli.cli.app import open_streams; open_streams()\n"
    script += "assert os.open(sys.argv[1], os.O_RDONLY) > 2"
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
