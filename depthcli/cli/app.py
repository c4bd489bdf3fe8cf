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

_GC_THRESHOLD = 50_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code. Without arguments, they are the process's."""
    if arguments is not None:
        return _run(list(arguments))
    if not sys.warnoptions:  # libraries' warnings are for developers
        warnings.simplefilter("ignore")
    open_streams()
    message = ""
    try:
        code = _run(sys.argv[1:], is_process=True)
    except OSError as error:
        message = f"depthcli: error: cannot write standard output: {error.strerror}\n"
        code = 1
    try:
        sys.stderr.write(message)
        sys.stderr.flush()
    except OSError:  # it is closed or full; the exit code says what happened
        pass
    # Without clean-up of the interpreter: to unload onnxruntime and OpenCV takes longer than to
    # read an image, and would crash a thread that still loads a model.
    os._exit(code)


def _prepare() -> None:
    import signal

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # no traceback before handlers are installed
    # Garbage collection of a hundred thousand permanent objects, while modules load and at exit,
    # would take a tenth of the time of one image.
    gc.set_threshold(_GC_THRESHOLD)
    # NumPy's OpenBLAS starts a thread per core that spins for 60 ms before it sleeps, while the
    # model loads on the same cores, and crashes if memory is too short for their stacks.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # For modules that import onnxruntime themselves; see depthcli/inference/session.py.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")


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
            from depthcli.cli.shell import end_on_signals, run

            if is_process:
                end_on_signals()
            code = run(arguments)
        sys.stdout.flush()
    except BrokenPipeError:  # the reader has exited: stop silently, as other filters do
        from depthcli.errors import ExitCode

        return ExitCode.SOME_FAILED
    return code


def open_streams() -> None:
    """Make streams that are closed raise on reading and writing, and buffer standard output.

    If a stream were left closed, the next file that is opened would get its number, and C libraries
    would write warnings into that file. Unbuffered, as with PYTHONUNBUFFERED in containers, Python
    loses what a full disk or pipe does not take (https://github.com/python/cpython/issues/86210).
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            handle = os.open(os.devnull, os.O_RDONLY if number else os.O_WRONLY)
            if handle != number:
                os.dup2(handle, number)
                os.close(handle)
            os.set_inheritable(number, True)
            setattr(sys, name, os.fdopen(number, "w" if number else "r", closefd=False))
    if isinstance(sys.stdout.buffer, io.RawIOBase):
        number, encoding, errors = sys.stdout.fileno(), sys.stdout.encoding, sys.stdout.errors
        sys.stdout = os.fdopen(number, "w", 1, encoding, errors, closefd=False)
