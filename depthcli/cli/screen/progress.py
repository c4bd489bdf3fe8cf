"""Progress display: a bar with rate and remaining time on a terminal, lines elsewhere, or JSON."""

from __future__ import annotations

import json
import math
import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

from depthcli.cli.screen import console
from depthcli.core.options import one_line

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.progress import Progress as Bars

    from depthcli.cli.options import ScreenOptions

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
        self._what = one_line(what)
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
        as_json, every_s = self._shown.as_json, _LINE_EVERY_S if bars is None else _BAR_EVERY_S
        is_due = now_s - self._shown_s >= (_JSON_EVERY_S if as_json else every_s)
        is_last = done == self._total and (as_json or bars is not None)
        if not (as_json or not self._shown.silent) or not (is_due or is_last):
            return
        self._shown_s = now_s
        if as_json:
            self._print_json()
            return
        if bars is not None:
            bars.update(self._task, completed=done, speed=self.speed(), refresh=True)
            return
        name = f"{self._what}: " if self._what else ""
        of = "" if self._total is None else f"/{self._total}"
        console.note(f"{name}{done}{of}  {self.speed()}")

    def _print_json(self) -> None:
        rate, left_s = self._rate(), None
        if rate and self._total is not None:
            left_s = round(max(0, self._total - self._done) / rate, 1)
        facts = {"phase": self._what, "done": math.ceil(self._done), "total": self._total}
        facts |= {"rate": round(rate, 3), "seconds_left": left_s, "file": self.file}
        console.note(json.dumps(facts))

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
                parts.append(f"{time_text(max(0, self._total - self._done) / rate)} to go")
        return "  ".join([*parts, self.note] if self.note else parts)


def time_text(seconds: float) -> str:
    """Minutes and seconds; of an hour or more, hours and minutes, and of a day or more, days.

    >>> time_text(95), time_text(5_000), time_text(10_183_500)
    ('1:35', '1 h 23 min', '117 d 20 h')
    """
    minutes, rest = divmod(round(seconds), 60)
    hours, days = minutes // 60, minutes // 1440
    if days:
        return f"{days} d {hours % 24} h"
    return f"{hours} h {minutes % 60} min" if hours else f"{minutes}:{rest:02}"


class ProgressDisplay(NamedTuple):
    """A :class:`depthcli.core.progress.Progress` on standard error."""

    bars: Bars | None  #: on a terminal
    silent: bool  #: whether nothing is shown
    as_json: bool = False  #: whether JSON lines are printed

    def begin(self, what: str, total: int | None, unit: str = "") -> Stage:
        """Begin a stage, which is called with the number of units that are done."""
        return Stage(what, total, unit, self)


@contextmanager
def show_progress(screen: ScreenOptions) -> Iterator[ProgressDisplay]:
    """Show progress during the block, as JSON or where text is shown."""
    if screen.progress == "json":
        yield ProgressDisplay(None, silent=True, as_json=True)
        return
    if not (screen.shows_text and sys.stderr.isatty()):
        yield ProgressDisplay(None, silent=not screen.shows_text)
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
    with bars, console.above(bars):
        yield ProgressDisplay(bars, silent=False)
