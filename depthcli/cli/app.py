"""Where the command line begins, and the table of its commands.

Only built-in modules are loaded here: the help and the version are text, and cost little more than
Python itself.
"""

from __future__ import annotations

import contextlib
import gc
import os
import sys
from typing import TYPE_CHECKING, NoReturn

from depthcli import __version__
from depthcli.errors import ExitCode

if TYPE_CHECKING:
    from collections.abc import Sequence

PROGRAM = "depthcli"
_GC_THRESHOLD = 50_000
_LEAVE_AT_ONCE = frozenset({"predict", "batch"})
COMMANDS = {
    "predict": (
        "depthcli.cli.commands.predict",
        "Depth maps from pictures: 16-bit PNG, EXR, NPY, preview, PLY.",
    ),
    "batch": ("depthcli.cli.commands.batch", "Depth maps for a folder tree; can be resumed."),
    "video": (
        "depthcli.cli.commands.video",
        "Depth video: lossless 16-bit, preview, or image sequence.",
    ),
    "models": ("depthcli.cli.commands.models", "List, inspect, verify, add and remove models."),
    "profile": ("depthcli.cli.commands.profile", "Save options under a name, for --profile."),
    "convert": (
        "depthcli.cli.commands.convert",
        "Convert a depth file and report the conversion error.",
    ),
    "info": ("depthcli.cli.commands.info", "Show unit, scale and range of a depth file."),
    "probe": ("depthcli.cli.commands.probe", "Show the depth at given pixels of a depth file."),
    "eval": ("depthcli.cli.commands.eval.nyu", "Evaluate accuracy on NYU Depth v2."),
    "train": ("depthcli.cli.commands.train", "Train a model with one of seven methods."),
    "export-onnx": (
        "depthcli.cli.commands.export",
        "Export a checkpoint to ONNX with a model card.",
    ),
    "bench": ("depthcli.cli.commands.bench", "Benchmark a model: latency, throughput, memory."),
    "doctor": ("depthcli.cli.commands.doctor", "Check the installation: provider, model, codecs."),
}
"""Name -> (module whose ``app`` is the command, one line of help)."""
PROFILED = frozenset({"predict", "batch", "video"})
"""Commands that take ``--profile``."""

_HELP = """\
Usage: depthcli COMMAND [OPTIONS] [ARGUMENTS]...

Monocular depth estimation on the command line.

Commands:
{commands}

Options:
  --version             Show the version and exit.
  -h, --help            Show this help, or the help of a command.
  --install-completion  Install completion for the current shell.
  --show-completion     Print the completion script for the current shell.

Exit codes: 0 success, 1 some inputs failed, 2 usage error, 3 model or runtime
error, 130 interrupted.
"""


def help_text() -> str:
    """The text of ``depthcli --help``."""
    rows = (f"  {name:<12} {summary}" for name, (_, summary) in COMMANDS.items())
    return _HELP.format(commands="\n".join(rows))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: without the program's name; None for the process's own.

    Returns:
        The exit code, see :class:`depthcli.errors.ExitCode`.
    """
    if arguments is not None:
        return _run(list(arguments))
    # Collecting garbage among a hundred thousand objects that all stay, while modules load and
    # again at exit, would be a tenth of the time of one picture.
    gc.set_threshold(_GC_THRESHOLD)
    # numpy's OpenBLAS starts a thread a core, which spin for 60 ms before they sleep, while the
    # model is loaded on these same cores. This lets them sleep at once.
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")
    words = sys.argv[1:]
    code = _run(words)
    if words and words[0] in _LEAVE_AT_ONCE:
        _leave(code)
    gc.freeze()
    return code


def _leave(code: int) -> NoReturn:
    """End the process as it is.

    Taking onnxruntime and OpenCV apart costs more than reading a picture, and a thread that still
    loads a model would crash it.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # said by the command that wrote, or nobody listens
            if stream is not None:
                stream.flush()
    os._exit(code)


def _run(words: list[str]) -> int:
    text = None if f"_{PROGRAM.upper()}_COMPLETE" in os.environ else _plain_text(words)
    if text is not None:
        return _show(text)
    from depthcli.cli.shell import run

    return run(words)


def _show(text: str) -> int:
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        return reader_left()
    return ExitCode.OK


def reader_left() -> int:
    """Whoever read our output is gone: stop silently, as other filters do."""
    sink = os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, sys.stdout.fileno())
    return ExitCode.SOME_FAILED


def _plain_text(words: list[str]) -> str | None:
    """The answer to a question that needs no command."""
    if words in ([], ["--help"], ["-h"]):
        return help_text()
    if words == ["--version"]:
        return f"{PROGRAM} {__version__}\n"
    return None
