"""The only place that prints."""

from __future__ import annotations

import errno
import json
import os
import re
import sys
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from depthcli.core.ending import before_ending
from depthcli.core.text import one_line
from depthcli.errors import ExitCode

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from typing import TextIO

    from rich.progress import Progress, ProgressColumn


@dataclass(slots=True)
class State:
    """What a run of the command line remembers for its end."""

    debug: bool = False  #: whether an error shows its traceback


_CONTROL = r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]"
"""What is neither a character nor the end of a line or a cell; names and cards may hold any."""
_GAP = 2  # between columns
_told: set[str] = set()
"""What standard output got: results, accounts of files."""
_bars: list[Progress] = []
"""The progress bar on the terminal, if there is one."""


@contextmanager
def bar(*columns: ProgressColumn) -> Iterator[Progress]:
    """A progress bar on standard error; lines that are written meanwhile stand above it.

    It is drawn when it is told to: a thread that redraws would take turns from the workers.
    """
    from rich.console import Console
    from rich.progress import Progress

    with Progress(
        *columns,
        console=Console(stderr=True),
        auto_refresh=False,
        transient=True,
        redirect_stdout=False,  # else results that go into a file would go to the terminal
    ) as shown:
        _bars.append(shown)
        try:
            with before_ending(_clear_bar):
                yield shown
        finally:
            _bars.remove(shown)


def _clear_bar() -> None:
    """Leave the terminal with an empty line and its cursor, without waiting for Rich's lock."""
    os.write(sys.stderr.fileno(), b"\r\x1b[K\x1b[?25h")


def out(text: str) -> None:
    """A line of results, to standard output."""
    _told.add("results")
    _write_line(sys.stdout, text)


def say(text: str) -> None:
    """A line about files that were written, to standard output."""
    _told.add("files")
    _write_line(sys.stdout, text)


def out_json(values: Mapping[str, object]) -> None:
    """One JSON object on one line, at once, so that a reader can follow."""
    _told.add("results")
    sys.stdout.write(json.dumps(values, ensure_ascii=True, allow_nan=False) + "\n")
    sys.stdout.flush()


def note(text: str) -> None:
    """A line about the run, to standard error."""
    _write_line(sys.stderr, text)


def warn(text: str) -> None:
    """A warning, one line on standard error."""
    _write_line(sys.stderr, f"depthcli: warning: {one_line(text)}")


def error(text: str) -> None:
    """An error, one line on standard error."""
    _write_line(sys.stderr, f"depthcli: error: {one_line(text)}")


def untold(problem: OSError, code: int) -> int:
    """Say that standard output did not take all; it is an error if it was to have results.

    Args:
        problem: why.
        code: the exit code of the command but for that.

    Returns:
        The exit code.
    """
    if code and not _told:  # an error of its own, which was told
        return code
    is_closed = problem.errno == errno.EBADF
    reason = "it is closed" if is_closed else problem.strerror or str(problem)
    if _told != {"files"}:
        error(f"cannot write standard output: {reason}")
        return code or ExitCode.SOME_FAILED
    if not is_closed:  # on purpose
        warn(f"cannot write standard output: {reason}")
    return code


def trace(problem: BaseException) -> None:
    """The traceback behind an error, to standard error."""
    import traceback

    traceback.print_exception(problem, file=sys.stderr)


def _write_line(stream: TextIO, text: str) -> None:
    """A line, with escapes for what a terminal would obey or the encoding does not have."""
    text = re.sub(_CONTROL, lambda found: one_line(found[0]), text)
    if _bars and stream.isatty():
        # Standard error is Rich's own now: it has no encoding, and wraps lines.
        shown = _bars[-1].console
        text = _encodable(text, cast("TextIO", shown.file))
        shown.print(text, markup=False, highlight=False, emoji=False, soft_wrap=True)
    else:
        stream.write(_encodable(text, stream) + "\n")


def _encodable(text: str, stream: TextIO) -> str:
    encoding = stream.encoding or "ascii"
    return text.encode(encoding, "backslashreplace").decode(encoding)


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table on standard output: in columns on a terminal, tab-separated elsewhere.

    Nothing is cut short or folded, so that names and paths can be copied: where a terminal is too
    narrow for the columns, each row becomes a paragraph.
    """
    lines = [[one_line(cell) for cell in row] for row in (header, *rows)]
    if not sys.stdout.isatty():
        for line in lines:
            out("\t".join(line))
        return
    from shutil import get_terminal_size

    from rich.cells import cell_len, set_cell_size

    widths = [max(map(cell_len, column)) for column in zip(*lines, strict=True)]
    if sum(widths) + _GAP * (len(widths) - 1) > get_terminal_size().columns:
        _paragraphs(lines[0], lines[1:])
        return
    for line in lines:
        cells = (set_cell_size(cell, width) for cell, width in zip(line, widths, strict=True))
        out((" " * _GAP).join(cells).rstrip())


def _paragraphs(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Each row as a heading and a line for each other column."""
    width = max(map(len, header)) + _GAP
    for heading, *cells in rows:
        out(heading)
        for name, cell in zip(header[1:], cells, strict=True):
            out(f"  {name:<{width}}{cell}".rstrip())
