"""Printing to standard output and standard error, and progress; no other module prints.

Progress is a bar with rate and remaining time on a terminal, lines elsewhere, or JSON.
"""

from __future__ import annotations

import json
import math
import os
import re
import sys
import time
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, cast

from depthcli.core import options, parallel
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
        out(options.one_line(line))


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
    _write_line(sys.stderr, f"depthcli: warning: {options.one_line(worded(text))}")


def warn_all(texts: Iterable[str], name: str = "") -> None:
    """Print warnings, a line each, which begins with the name of what it is about."""
    for text in texts:
        warn(about(name, text) if name else text)


def error(text: str) -> None:
    """Print an error as one line to standard error."""
    _write_line(sys.stderr, f"depthcli: error: {options.one_line(worded(text))}")


def _write_line(stream: TextIO, text: str) -> None:
    """Write a line; control characters, and those that cannot be encoded, are escaped."""
    text = re.sub(_CONTROL, lambda match: options.one_line(match[0]), text)
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
    lines = [[options.one_line(cell) for cell in row] for row in (header, *rows)]
    if not sys.stdout.isatty():
        for line in lines:
            out("\t".join(line))
        return
    from rich.cells import cell_len, set_cell_size

    widths = [max(map(cell_len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        cells = (set_cell_size(cell, width) for cell, width in zip(line, widths, strict=True))
        out((" " * _GAP).join(cells).rstrip())


_LINE_EVERY_S = 10.0
_BAR_EVERY_S = 0.2
_JSON_EVERY_S = 0.5
_FAST = 10.0  # units per second, of which one decimal is shown


class Stage:
    """A stage of the work: a bar on a terminal, else a line every ten seconds, or nothing.

    With ``--progress json``, it is a JSON line twice a second, at its beginning and at its end.

    Attributes:
        note: text after rate and remaining time.
        file: name of the last input that is done; None where there is none.
    """

    def __init__(self, what: str, total: int | None, unit: str, display: ProgressDisplay) -> None:
        self.note, self.file = "", None  # type: str, str | None
        self._what = options.one_line(what)
        self._total, self._shown = total, display
        self._per_second = f" {unit}/s" if unit else "/s"
        self._done = self._skipped = 0.0
        self._start_s = self._shown_s = time.monotonic()
        if display.bars is not None:
            self._task = display.bars.add_task(self._what, total=total, speed="")
            display.bars.refresh()
        if display.as_json:
            self._print_json()

    def __call__(self, count: float) -> None:
        """Advance by ``count`` units."""
        self._done += count
        now_s, bars, done = time.monotonic(), self._shown.bars, math.ceil(self._done)
        is_last = done == self._total and (self._shown.as_json or bars is not None)
        if now_s - self._shown_s < self._shown.every_s and not is_last:
            return
        self._shown_s = now_s
        if self._shown.as_json:
            self._print_json()
        elif bars is not None:
            bars.update(self._task, completed=done, speed=self.speed(), refresh=True)
        else:
            name = f"{self._what}: " if self._what else ""
            of = "" if self._total is None else f"/{self._total}"
            note(f"{name}{done}{of}  {self.speed()}")

    def _print_json(self) -> None:
        rate, left_s = self._rate(), None
        if rate and self._total is not None:
            left_s = round(max(0, self._total - self._done) / rate, 1)
        facts = {"phase": self._what, "done": math.ceil(self._done), "total": self._total}
        facts |= {"rate": round(rate, 3), "seconds_left": left_s, "file": self.file}
        note(json.dumps(facts))

    def _rate(self) -> float:
        """Units a second, without those that took no time; 0 before the first."""
        worked = self._done - self._skipped
        return worked / max(time.monotonic() - self._start_s, 1e-9)

    def skip(self, count: int) -> None:
        """Advance by ``count`` units that took no time and do not count for the rate."""
        self._skipped += count
        self(count)

    def speed(self) -> str:
        """Units per second, remaining time, and the note."""
        rate, parts = self._rate(), []
        if rate:
            parts.append(f"{rate:.{1 if rate >= _FAST else 2}f}{self._per_second}")
            if self._total is not None:
                from datetime import timedelta

                left_s = max(0, self._total - self._done) / rate
                parts.append(f"{timedelta(seconds=round(left_s))} to go")
        return "  ".join([*parts, self.note] if self.note else parts)


class ProgressDisplay(NamedTuple):
    """A :class:`depthcli.core.parallel.Progress` on standard error."""

    bars: Progress | None  #: on a terminal
    every_s: float  #: seconds between what is shown; infinite if nothing is
    as_json: bool = False  #: whether JSON lines are printed

    def begin(self, what: str, total: int | None, unit: str = "") -> Stage:
        """Begin a stage, which is called with the number of units that are done."""
        return Stage(what, total, unit, self)


@contextmanager
def show_progress(*, is_shown: bool, as_json: bool) -> Iterator[ProgressDisplay]:
    """Show progress during the block, as JSON or as text."""
    if as_json or not (is_shown and sys.stderr.isatty()):
        every_s = _JSON_EVERY_S if as_json else _LINE_EVERY_S if is_shown else math.inf
        yield ProgressDisplay(None, every_s, as_json)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    bars = Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[speed]}", markup=False),
        console=Console(stderr=True),
        auto_refresh=False,  # a thread for it would slow the workers down
        transient=True,
        redirect_stdout=False,  # else redirected results would go to the terminal
    )
    # If the process ends, it clears the line and shows the cursor, without waiting for Rich's lock.
    with bars, parallel.exit_hook(partial(os.write, sys.stderr.fileno(), b"\r\x1b[K\x1b[?25h")):
        _bars.append(bars)
        try:
            yield ProgressDisplay(bars, _BAR_EVERY_S)
        finally:
            _bars.remove(bars)
