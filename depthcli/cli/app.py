"""Where the command line begins.

Only built-in modules are loaded here: the help and the version are text, and cost little more than
Python itself.
"""

from __future__ import annotations

import contextlib
import gc
import os
import sys
from typing import TYPE_CHECKING, NoReturn

from depthcli._version import __version__
from depthcli.cli.table import PROGRAM, help_text
from depthcli.errors import ExitCode

if TYPE_CHECKING:
    from collections.abc import Sequence

_GC_THRESHOLD = 50_000
_LEAVE_AT_ONCE = frozenset({"predict", "batch"})


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
    try:
        if text is not None:
            sys.stdout.write(text)
            sys.stdout.flush()
            return ExitCode.OK
        from depthcli.cli.shell import run

        return run(words)
    except BrokenPipeError:
        return _reader_left()


def _reader_left() -> int:
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
