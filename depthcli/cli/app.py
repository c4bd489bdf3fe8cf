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
    "predict": ("depthcli.cli.predict", "Depth of pictures: 16-bit PNG, EXR, NPY, preview, PLY."),
    "batch": ("depthcli.cli.batch", "Depth of a folder tree of pictures and videos; resumes."),
    "video": ("depthcli.cli.video", "Depth of a video: lossless 16-bit, preview, PNG or EXR."),
    "models": ("depthcli.cli.models", "The models that are here; add your own."),
    "profile": ("depthcli.cli.profile", "Options that are saved under a name, for --profile."),
    "convert": ("depthcli.cli.convert", "A depth file to another format, with the error it costs."),
    "info": ("depthcli.cli.info", "Unit, scale and range of a depth file."),
    "probe": ("depthcli.cli.probe", "Depth at one pixel of a depth file."),
    "eval": ("depthcli.cli.eval", "Accuracy on NYU Depth v2, in the paper's table."),
    "train": ("depthcli.cli.train", "Train one of the methods."),
    "export-onnx": ("depthcli.cli.export", "A checkpoint to one ONNX file and its card."),
    "bench": ("depthcli.cli.bench", "How fast a model is here: latency, throughput, memory."),
    "doctor": ("depthcli.cli.doctor", "What runs here: provider, model, codecs, conflicts."),
}
"""Name -> (module whose ``app`` is the command, one line of help)."""
PROFILED = frozenset({"predict", "batch", "video"})
"""Commands that take ``--profile``."""

_HELP = """\
Usage: depthcli COMMAND [OPTIONS] [ARGUMENTS]...

Depth from a single picture, at a shell prompt.

Commands:
{commands}

Options:
  --version             Show the version and exit.
  -h, --help            Show this text; after a command, the command's options.
  --install-completion  Install completion for the current shell.
  --show-completion     Show the completion script, to copy or adapt it.

Exit codes: 0 all done, 1 some inputs failed, 2 wrong usage, 3 model or runtime
failure, 130 interrupted.
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
