"""Progress display: a bar with rate and remaining time on a terminal, lines elsewhere."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

from depthcli.cli.screen import console
from depthcli.core.options import one_line

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.progress import Progress as Bars

_LINE_EVERY_S = 10.0
_BAR_EVERY_S = 0.2
_FAST = 10.0  # units per second, of which one decimal is shown


class Stage:
    """A stage of the work; this class counts and shows nothing.

    Attributes:
        note: text after rate and remaining time.
    """

    def __init__(self, what: str, total: int | None, unit: str) -> None:
        self.note = ""
        self._what = one_line(what)
        self._total = total
        self._per_second = f" {unit}/s" if unit else "/s"
        self._done = self._skipped = 0
        self._start_s = self._shown_s = time.monotonic()

    def __call__(self, count: int) -> None:
        """Advance by ``count`` units."""
        self._done += count

    def skip(self, count: int) -> None:
        """Advance by ``count`` units that took no time and do not count for the rate."""
        self._skipped += count
        self(count)

    def _is_due(self, every_s: float) -> bool:
        """Whether ``every_s`` have passed since this last returned True."""
        now_s = time.monotonic()
        if now_s - self._shown_s < every_s:
            return False
        self._shown_s = now_s
        return True

    def speed(self) -> str:
        """Units per second, remaining time, and the note."""
        worked, parts = self._done - self._skipped, []
        if worked:
            rate = worked / max(time.monotonic() - self._start_s, 1e-9)
            parts.append(f"{rate:.{1 if rate >= _FAST else 2}f}{self._per_second}")
            if self._total is not None:
                minutes, seconds = divmod(round(max(0, self._total - self._done) / rate), 60)
                parts.append(f"{minutes}:{seconds:02} to go")
        return "  ".join([*parts, self.note] if self.note else parts)


class _Line(Stage):
    """One line every ten seconds on standard error."""

    def __call__(self, count: int) -> None:
        super().__call__(count)
        if self._is_due(_LINE_EVERY_S):
            name = f"{self._what}: " if self._what else ""
            of = "" if self._total is None else f"/{self._total}"
            console.note(f"{name}{self._done}{of}  {self.speed()}")


class _Bar(Stage):
    def __init__(self, bars: Bars, what: str, total: int | None, unit: str) -> None:
        super().__init__(what, total, unit)
        self._bars = bars
        self._task = bars.add_task(self._what, total=total, speed="")
        bars.refresh()

    def __call__(self, count: int) -> None:
        super().__call__(count)
        if self._is_due(_BAR_EVERY_S) or self._done == self._total:
            self._bars.update(self._task, completed=self._done, speed=self.speed(), refresh=True)


class ProgressDisplay:
    """A :class:`depthcli.core.progress.Progress` on standard error."""

    def __init__(self, bars: Bars | None, *, silent: bool) -> None:
        self._bars, self._silent = bars, silent

    def begin(self, what: str, total: int | None, unit: str = "") -> Stage:
        """Begin a stage, which is called with the number of units that are done."""
        if self._silent:
            return Stage(what, total, unit)
        if self._bars is not None:
            return _Bar(self._bars, what, total, unit)
        return _Line(what, total, unit)


@contextmanager
def show_progress(*, silent: bool) -> Iterator[ProgressDisplay]:
    """Show progress during the block, unless ``silent``."""
    if silent or not sys.stderr.isatty():
        yield ProgressDisplay(None, silent=silent)
        return
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[speed]}", markup=False),
    )
    with console.progress_bar(*columns) as bars:
        yield ProgressDisplay(bars, silent=False)
