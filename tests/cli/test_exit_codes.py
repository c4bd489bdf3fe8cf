"""What a command that ends in an unforeseen way says, and its exit code."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest
import typer
from helpers.command_line import Cli, unmeasured

from depthcli.cli import shell
from depthcli.cli.table import COMMANDS
from depthcli.errors import InputError

# A picture of zeros, 8000 pixels square, read with 40 MB of address space to spare.
LITTLE_MEMORY = """
import resource, sys, zlib
from pathlib import Path
from helpers.made import chunk, png
from depthcli.cli.shell import run
side = 8000
small = png([b"\\0\\0"], 1, 8, 0)
head = chunk(b"IHDR", side.to_bytes(4) * 2 + bytes([8, 0, 0, 0, 0]))
data = chunk(b"IDAT", zlib.compress(bytes(side * (side + 1)), 1))
Path("large.png").write_bytes(small[:8] + head + data + small[-12:])
Path("small.png").write_bytes(small)
run(["predict", "small.png", "-o", "warm.png", "--quiet"])
with open("/proc/self/status") as status:
    (used,) = (int(line.split()[1]) << 10 for line in status if line.startswith("VmSize"))
resource.setrlimit(resource.RLIMIT_AS, (used + 40_000_000,) * 2)
sys.exit(run(sys.argv[1:]))
"""


@pytest.fixture
def ending(monkeypatch: pytest.MonkeyPatch) -> Callable[[BaseException], int]:
    """Runs a command that ends in an error, and gives the exit code."""

    def run(error: BaseException) -> int:
        module: Any = ModuleType("a_command")
        module.app = typer.Typer()

        @module.app.command()
        def command() -> None:
            """Fail."""
            raise error

        monkeypatch.setitem(sys.modules, "depthcli.cli.commands.a_command", module)
        monkeypatch.setitem(COMMANDS, "fail", ("a_command", "Fail."))
        return shell.run(["fail"])

    return run


def opencv_error(code: int) -> Exception:
    """As OpenCV raises it."""
    import cv2  # noqa: PLC0415 - not for the other tests

    error = cv2.error(f"OpenCV(5.0.0) alloc.cpp:73: error: ({code})\n")
    error.code = code
    return error


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (MemoryError(), 3, "out of memory"),
        (opencv_error(-4), 3, "out of memory"),
        (opencv_error(-215), 3, "unexpected error: OpenCV"),
        (InputError("a.jpg is empty"), 1, "a.jpg is empty"),
        (ModuleNotFoundError("no tomli", name="tomli"), 3, "unexpected ModuleNotFoundError"),
        (ModuleNotFoundError("no torch", name="torch.nn"), 3, "this command needs torch.nn"),
        (typer.Abort(), 130, "interrupted"),
    ],
)
def test_every_end_has_its_exit_code_and_one_line(
    ending: Callable[[BaseException], int],
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    said: str,
) -> None:
    assert ending(error) == code
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("depthcli: error: ")
    assert said in line


def test_ctrl_c_is_silent(
    ending: Callable[[BaseException], int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert ending(KeyboardInterrupt()) == 130
    assert capsys.readouterr().err == ""


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux how much memory is in use")
def test_a_picture_that_is_larger_than_the_memory_costs_only_itself(cli: Cli) -> None:
    words = ("predict", "large.png", "small.png", "-o", "out/", "--format", "png16")
    tests = os.path.join(os.path.dirname(__file__), "..")  # noqa: PTH118, PTH120
    done = subprocess.run(
        [sys.executable, "-c", LITTLE_MEMORY, *words],
        cwd=cli.folder,
        env=unmeasured(cli.environment) | {"PYTHONPATH": os.pathsep.join((str(cli.site), tests))},
        capture_output=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 1, done.stderr
    assert re.search(rb"large\.png:? does not fit into memory; make it smaller", done.stderr)
    assert [path.name for path in (cli.folder / "out").iterdir()] == ["small.depth.png"]
