"""Entry point of the command line.

Only modules of the standard library are imported here, so that help and version start fast.
"""

from __future__ import annotations

import gc
import io
import os
import sys
import warnings

from depthcli._version import __version__
from depthcli.cli.table import PROGRAM, help_text

TYPE_CHECKING = False  # checkers take it for typing's, which would be a quarter of ``--help``
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any, NoReturn

_GC_THRESHOLD = 50_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code. Without arguments, they are the process's."""
    if arguments is None:
        _exit(_run_process())
    return _run(list(arguments))


def _run_process() -> int:
    """Run the command of this process."""
    if not sys.warnoptions:  # libraries' warnings are for developers
        warnings.simplefilter("ignore")
    stdout = open_streams()
    code = _run(sys.argv[1:], is_process=True)
    problem = stdout.problem
    if problem is None:
        return code
    from depthcli.cli.screen.console import report_lost_output

    return report_lost_output(problem, code)


def _prepare() -> None:
    """Set up the process for a command."""
    import signal

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # no traceback before handlers are installed
    # Garbage collection of a hundred thousand permanent objects, while modules load and at exit,
    # would take a tenth of the time of one picture.
    gc.set_threshold(_GC_THRESHOLD)
    # NumPy's OpenBLAS starts a thread per core that spins for 60 ms before it sleeps, while the
    # model loads on the same cores. This lets the threads sleep at once.
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")
    # For modules that import onnxruntime themselves; see depthcli/inference/providers.py.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")


def _exit(code: int) -> NoReturn:
    """Exit without cleaning up the interpreter.

    Unloading onnxruntime and OpenCV takes longer than reading a picture, and would crash a thread
    that still loads a model.
    """
    sys.stderr.flush()
    os._exit(code)


def _run(arguments: list[str], *, is_process: bool = False) -> int:
    completes = f"_{PROGRAM.upper()}_COMPLETE" in os.environ
    try:
        if not completes and arguments in ([], ["--help"], ["-h"]):
            sys.stdout.write(help_text())
            code = 0
        elif not completes and arguments == ["--version"]:
            sys.stdout.write(f"{PROGRAM} {__version__}\n")
            code = 0
        else:
            if is_process:
                _prepare()
                from depthcli.cli.process import end_on_signals

                end_on_signals()
            from depthcli.cli.shell import run

            code = run(arguments)
        sys.stdout.flush()
    except BrokenPipeError:  # the reader has exited: stop silently, as other filters do
        from depthcli.errors import ExitCode

        return ExitCode.SOME_FAILED
    return code


_SETTINGS = ("encoding", "errors", "line_buffering", "write_through")


class Stream(io.TextIOWrapper):
    """A standard stream that stores the first error (``problem``) instead of raising it.

    A broken pipe is raised if ``needs_reader`` is set, as for standard output.
    """

    problem: OSError | None = None
    needs_reader = False

    def write(self, text: str) -> int:
        """Write as much as possible."""
        try:
            return super().write(text)
        except OSError as error:
            self._store(error)
            return len(text)

    def flush(self) -> None:
        """Flush as much as possible."""
        try:
            super().flush()
        except OSError as error:
            self._store(error)

    def _store(self, error: OSError) -> None:
        if self.needs_reader and isinstance(error, BrokenPipeError):
            raise error
        self.problem = self.problem or error


def open_streams() -> Stream:
    """Make closed streams raise on reading and writing, and the others store errors.

    If a stream were left closed, the next file that is opened would get its number, and C libraries
    would write warnings into that file. Returns standard output.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            handle = os.open(os.devnull, os.O_RDONLY if number else os.O_WRONLY)
            if handle != number:
                os.dup2(handle, number)
                os.close(handle)
            os.set_inheritable(number, True)
            setattr(sys, name, os.fdopen(number, "w" if number else "r", closefd=False))
    sys.stderr = _wrap(sys.stderr)
    sys.stdout = stdout = _wrap(sys.stdout)
    stdout.needs_reader = True
    return stdout


def _wrap(original: Any) -> Stream:  # noqa: ANN401 - TextIO has no detach
    settings = {name: getattr(original, name) for name in _SETTINGS}
    return Stream(original.detach(), **settings)
