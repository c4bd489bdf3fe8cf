"""Printing to standard output and standard error; no other module prints."""

from __future__ import annotations

import json
import os
import re
import sys
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, cast

from depthcli.core.options import one_line
from depthcli.core.progress import exit_hook
from depthcli.errors import Message, OutputError, about, os_errors_as

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from typing import TextIO

    from rich.progress import Progress


_CONTROL = r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]"
"""Control and bidirectional formatting characters, except tab and newline."""
_GAP = 2  # between columns
_OPTIONS = {
    "formats": "format",
    "as_json": "json",
    "settings": "set",
    "init_weights": "init",
    "known_object": "object",
    "hfov_deg": "hfov",
    "provider_options": "provider-option",
    "max_depth_m": "max-depth",
    "eye_distance_m": "eye-distance",
    "convergence_m": "convergence",
}  #: names of options that differ from those of their parameters
_bars: list[Progress] = []  #: the active progress bar, if there is one


@contextmanager
def above(bar: Progress) -> Iterator[None]:
    """Print lines above a progress bar, which is cleared if the process ends."""
    _bars.append(bar)
    try:
        # It clears the line and shows the cursor, without waiting for Rich's lock.
        with exit_hook(partial(os.write, sys.stderr.fileno(), b"\r\x1b[K\x1b[?25h")):
            yield
    finally:
        _bars.remove(bar)


def out(text: str) -> None:
    """Print a line of results to standard output."""
    _write_line(sys.stdout, text)


def out_json(values: Mapping[str, object]) -> None:
    """Print a JSON object as one line to standard output, and flush."""
    with os_errors_as(OutputError, "cannot write standard output"):
        sys.stdout.write(json.dumps(values, ensure_ascii=True, allow_nan=False) + "\n")
        sys.stdout.flush()


def show(facts: Mapping[str, object], *lines: str, as_json: bool) -> None:
    """Print a result to standard output: an object, or lines of text."""
    if as_json:
        out_json(facts)
    for line in () if as_json else lines:
        out(one_line(line))


def worded(text: str) -> str:
    """A message with the names of options; another text as it is."""
    if isinstance(text, Message):
        return text.worded(lambda name: f"--{_OPTIONS.get(name, name).replace('_', '-')}")
    return text


def note(text: str) -> None:
    """Print a line about the run to standard error."""
    _write_line(sys.stderr, text)


def warn(text: str) -> None:
    """Print a warning as one line to standard error."""
    _write_line(sys.stderr, f"depthcli: warning: {one_line(worded(text))}")


def warn_all(texts: Iterable[str], name: str = "") -> None:
    """Print warnings, a line each, which begins with the name of what it is about."""
    for text in texts:
        warn(about(name, text) if name else text)


def error(text: str) -> None:
    """Print an error as one line to standard error."""
    _write_line(sys.stderr, f"depthcli: error: {one_line(worded(text))}")


def _write_line(stream: TextIO, text: str) -> None:
    """Write a line; control characters, and those that cannot be encoded, are escaped."""
    text = re.sub(_CONTROL, lambda match: one_line(match[0]), text)
    bar_console = _bars[-1].console if _bars and stream.isatty() else None
    # Rich's replacement of standard error has no encoding.
    encoding = (cast("TextIO", bar_console.file) if bar_console else stream).encoding or "ascii"
    text = text.encode(encoding, "backslashreplace").decode(encoding)
    if bar_console:
        bar_console.print(text, markup=False, highlight=False, emoji=False, soft_wrap=True)
        return
    try:
        stream.write(text + "\n")
    except OSError:
        if stream is not sys.stderr:  # closed or full; the exit code says what happened
            raise


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table to standard output: in columns on a terminal, tab-separated elsewhere.

    Cells are not truncated, so that names and paths can be copied.
    """
    lines = [[one_line(cell) for cell in row] for row in (header, *rows)]
    if not sys.stdout.isatty():
        for line in lines:
            out("\t".join(line))
        return
    from rich.cells import cell_len, set_cell_size

    widths = [max(map(cell_len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        cells = (set_cell_size(cell, width) for cell, width in zip(line, widths, strict=True))
        out((" " * _GAP).join(cells).rstrip())
