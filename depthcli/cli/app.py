"""Where the command line begins.

Only built-in modules are loaded here: the help and the version are text, and cost little more than
Python itself.
"""

from __future__ import annotations

import gc
import os
import sys
import warnings

from depthcli._version import __version__
from depthcli.cli.streams import open_streams
from depthcli.cli.table import PROGRAM, help_text

TYPE_CHECKING = False  # as in depthcli/__init__.py
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import NoReturn

_GC_THRESHOLD = 50_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: without the program's name; None for the process's own.

    Returns:
        The exit code, see :class:`depthcli.errors.ExitCode`.
    """
    if arguments is None:
        _leave(_process())
    return _run(list(arguments))


def _process() -> int:
    """Run the command that this process was started for."""
    if not sys.warnoptions:  # of libraries to those who program with them
        warnings.simplefilter("ignore")
    stdout = open_streams()
    code = _run(sys.argv[1:], is_process=True)
    problem = stdout.problem
    if problem is None:
        return code
    from depthcli.cli.screen.console import untold

    return untold(problem, code)


def _prepare() -> None:
    """Set the process up for more than printing the help."""
    import signal

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # no traceback, until there is more to do
    # Collecting garbage among a hundred thousand objects that all stay, while modules load and
    # again at exit, would be a tenth of the time of one picture.
    gc.set_threshold(_GC_THRESHOLD)
    # numpy's OpenBLAS starts a thread a core, which spin for 60 ms before they sleep, while the
    # model is loaded on these same cores. This lets them sleep at once.
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")
    # For what imports onnxruntime by itself; see depthcli/inference/runtime.py.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    if _is_limited():  # OpenBLAS would crash where it cannot start its threads
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def _is_limited() -> bool:
    """Whether this process may only have so much address space, as after ``ulimit -v``."""
    try:
        import resource
    except ImportError:  # Windows
        return False
    return resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY


def _leave(code: int) -> NoReturn:
    """End the process as it is.

    Taking onnxruntime and OpenCV apart costs more than reading a picture, and a thread that still
    loads a model would crash it.
    """
    sys.stderr.flush()
    os._exit(code)


def _run(words: list[str], *, is_process: bool = False) -> int:
    text = None if f"_{PROGRAM.upper()}_COMPLETE" in os.environ else _plain_text(words)
    try:
        if text is not None:
            sys.stdout.write(text)
            code = 0
        else:
            if is_process:
                _prepare()
                from depthcli.cli.signals import end_on_signals

                end_on_signals()
            from depthcli.cli.shell import run

            code = run(words)
        sys.stdout.flush()
    except BrokenPipeError:  # whoever read our output is gone: stop silently, as other filters do
        from depthcli.errors import ExitCode

        return ExitCode.SOME_FAILED
    return code


def _plain_text(words: list[str]) -> str | None:
    """The answer to a question that needs no command."""
    if words in ([], ["--help"], ["-h"]):
        return help_text()
    if words == ["--version"]:
        return f"{PROGRAM} {__version__}\n"
    return None
