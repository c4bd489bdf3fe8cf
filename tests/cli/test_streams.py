"""Standard streams, progress, signals and exit codes."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import typer
from helpers.command_line import ROOT, Cli, finished, unmeasured
from helpers.folders import tree
from helpers.tiny import endless_onnx, write_image, write_model

from depthcli.cli import shell
from depthcli.cli.options import ScreenOptions
from depthcli.cli.screen import console
from depthcli.cli.shell import ending_signals, graceful_shutdown
from depthcli.cli.table import COMMANDS
from depthcli.errors import InputError
from robustness import killed


def in_bash(cli: Cli, line: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A line of the shell that was run in the command's folder."""
    return finished(["bash", "-c", line], cli.folder, env=cli.environment | environment)


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
    write_image(cli.folder / "in" / "a.png")
    done = in_bash(cli, f"{shlex.join(cli.command(*words.split()))} {stream}")
    assert done.returncode == 1
    assert "cannot write standard output" in done.stderr.splitlines()[-1]
    assert (cli.folder / "out" / "manifest.jsonl").exists() == words.startswith("batch")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no /dev/full")
@pytest.mark.parametrize("stream", ["2>&-", "2>/dev/full"])
@pytest.mark.parametrize(
    ("words", "code"),
    [("predict none.png", 1), ("none", 2), ("predict a.png -o a.ply --overwrite", 0)],
)
def test_the_exit_code_does_not_depend_on_standard_error(
    cli: Cli, words: str, code: int, stream: str
) -> None:
    """The last warns. It was 120 or 134, as Python cleaned up while the model loaded."""
    write_image(cli.folder / "a.png")
    line = f"{shlex.join(cli.command(*words.split()))} {stream}"
    assert in_bash(cli, line).returncode == code


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are Linux's")
def test_too_little_memory_is_no_crash(cli: Cli) -> None:
    """OpenBLAS could not start its threads, and ended the process by a signal."""
    write_image(cli.folder / "a.png")
    line = f"ulimit -v 480000; {shlex.join(cli.command('info', 'a.png'))}"
    done = finished(["bash", "-c", line], cli.folder, env=unmeasured(cli.environment))
    assert done.returncode in {1, 3}


@pytest.mark.parametrize("words", ["-o -", "-o out/ --json"])
def test_a_disk_that_gets_full_is_an_error_without_buffers(cli: Cli, words: str) -> None:
    """Containers set PYTHONUNBUFFERED, where Python lost the rest (python/cpython#86210)."""
    write_image(cli.folder / "a.png")
    (cli.folder / "almost").write_bytes(bytes(2**20 - 100))
    line = shlex.join(cli.command("predict", "a.png", *words.split()))
    done = in_bash(cli, f"ulimit -f 1024; {line} >>almost", PYTHONUNBUFFERED="1")
    assert done.returncode == 1


def test_no_file_takes_the_place_of_a_closed_stream(cli: Cli) -> None:
    script = "import os, sys; from depthcli.cli.app import open_streams; open_streams()\n"
    script += "assert os.open(sys.argv[1], os.O_RDONLY) > 2"
    line = f"{shlex.join([sys.executable, '-c', script, __file__])} <&- >&- 2>&-"
    assert in_bash(cli, line).returncode == 0


def test_control_characters_are_escaped(capsys: pytest.CaptureFixture[str]) -> None:
    console.out("a\x1b[31m\x07\tb\nc\u202e")
    console.note("\x9b2J é")
    out, err = capsys.readouterr()
    assert out == "a\\x1b[31m\\x07\tb\nc\\u202e\n"
    assert err == "\\x9b2J é\n"


def test_a_batch_has_a_bar_on_a_terminal(cli: Cli) -> None:
    tree(cli, "a.png", "b.png", "c.png")
    code, output = cli.on_a_terminal("batch", "in", "--out", "out")
    assert code == 0
    assert "3/3" in output
    assert re.search(r"\d inputs/s +0:00:00 to go", output)


@pytest.mark.parametrize("words", [("--quiet",), ("--json",)])
def test_no_bar_for_machines(cli: Cli, words: tuple[str, ...]) -> None:
    tree(cli, "a.png")
    code, output = cli.on_a_terminal("batch", "in", "--out", "out", *words)
    assert code == 0
    assert "to go" not in output
    assert "1/1" not in output


def test_elsewhere_a_line_is_said_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(console, "_LINE_EVERY_S", 0)
    with ScreenOptions().show_progress() as drawing:
        drawing.begin("a.mp4", 4, "frames")(2)
    stderr = capsys.readouterr().err
    assert re.fullmatch(r"a\.mp4: 2/4  \d+\.\d frames/s  \d+:\d\d:\d\d to go\n", stderr)


ENDLESS_S = 3
"""More processor time than the start of a command takes: its network runs."""


def _processor_time_s(pid: int) -> int:
    done = subprocess.run(["ps", "-o", "time=", "-p", str(pid)], capture_output=True, check=True)
    hours, minutes, seconds = map(int, done.stdout.split(b":"))
    return hours * 3600 + minutes * 60 + seconds


@pytest.mark.parametrize("command", ["predict", "batch"])
def test_a_network_that_never_ends_does_not_outlive_ctrl_c(cli: Cli, command: str) -> None:
    write_model(cli.models / "default", endless_onnx())
    write_image(cli.folder / "in" / "a.png")
    words = ("predict", "in/a.png", "-o", "out/") if command == "predict" else ("batch", "in")
    process = cli.started(*words, *(("--out", "out") if command == "batch" else ()))
    until = time.monotonic() + 60
    while time.monotonic() < until and _processor_time_s(process.pid) < ENDLESS_S:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=20)
    assert process.returncode == 130
    assert b"resume" in stderr if command == "batch" else not stderr
    assert not list(cli.folder.glob("out/*.png"))


def test_signals_that_the_caller_ignores_stay_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # what nohup does
    try:
        assert signal.SIGHUP not in ending_signals()
        with graceful_shutdown(60.0, bool) as interrupt:
            signal.raise_signal(signal.SIGHUP)
            assert interrupt.number is None
            signal.raise_signal(signal.SIGTERM)
            assert interrupt.number == signal.SIGTERM
    finally:
        signal.signal(signal.SIGHUP, before)


def test_nothing_is_left_at_times_and_the_next_run_gives_the_same_bytes(tmp_path: Path) -> None:
    """A sample of the long command robustness/killed.py."""
    names = ("batch", "frames")
    killed.room(tmp_path, names)
    cli = Cli(ROOT, tmp_path, tmp_path / "models")
    assert killed.attack(cli, names, moments=1, seed=3, cold_every=1) == []


# An image of zeros, 8000 pixels square, read with 40 MB of address space to spare.
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

        def command() -> int:
            """Fail."""
            raise error

        module.command = command
        monkeypatch.setitem(sys.modules, "depthcli.cli.commands.a_command", module)
        monkeypatch.setitem(COMMANDS, "fail", ("a_command:command", "Fail."))
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
        (ModuleNotFoundError("no torch", name="torch.nn"), 3, "this needs torch; install"),
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
def test_an_image_that_is_larger_than_the_memory_costs_only_itself(cli: Cli) -> None:
    words = ("predict", "large.png", "small.png", "-o", "out/", "--format", "png16")
    tests = os.path.join(os.path.dirname(__file__), "..")  # noqa: PTH118, PTH120
    path = {"PYTHONPATH": os.pathsep.join((str(cli.site), tests))}
    command = [sys.executable, "-c", LITTLE_MEMORY, *words]
    done = finished(command, cli.folder, env=unmeasured(cli.environment) | path)
    assert done.returncode == 1, done.stderr
    assert re.search(r"large\.png:? does not fit into memory; make it smaller", done.stderr)
    assert [path.name for path in (cli.folder / "out").iterdir()] == ["small.depth.png"]


def test_progress_as_json_is_lines_on_standard_error(inside: Cli) -> None:
    for name in "abc":
        write_image(inside.folder / "in" / f"{name}.png")
    done = inside("batch", "in", "-o", "out", "--progress", "json", "--quiet")
    lines = [json.loads(line) for line in done.stderr.splitlines()]
    assert [lines[0][key] for key in ("phase", "done", "total")] == ["", 0, 3]
    assert [lines[-1][key] for key in ("done", "total", "seconds_left")] == [3, 3, 0]
    assert lines[-1]["file"] in {"a.png", "b.png", "c.png"}
    assert lines[-1]["rate"] > 0
    refused = inside("batch", "in", "-o", "out", "--progress", "xml", code=2)
    assert b"'xml' is not one of 'auto', 'json'" in refused.stderr


@pytest.mark.parametrize(("words", "level"), [(("-v",), ""), ((), "info"), ((), "")])
def test_the_log_is_silent_unless_it_is_asked_for(
    words: tuple[str, ...], level: str, cli: Cli
) -> None:
    write_image(cli.folder / "a.png")
    done = cli("predict", "a.png", "-o", "a.npy", *words, DEPTHCLI_LOG=level)
    assert (b"INFO depthcli.inference.loading: model tiny" in done.stderr) == bool(words or level)
    assert (b"DEBUG depthcli.jobs.image: a.png" in done.stderr) == bool(words)
    refused = cli("predict", "a.png", "-o", "b.npy", DEPTHCLI_LOG="loud")
    assert (refused.returncode, b"DEPTHCLI_LOG is a level" in refused.stderr) == (2, True)


def test_no_colour_is_printed_where_no_color_is_set(cli: Cli) -> None:
    write_image(cli.folder / "in/a.png")
    colours = re.compile(r"\x1b\[[1-9][0-9;]*m")
    assert colours.search(cli.on_a_terminal("batch", "in", "-o", "out")[1])
    code, output = cli.on_a_terminal("batch", "in", "-o", "out2", NO_COLOR="1")
    assert (code, colours.findall(output)) == (0, [])
