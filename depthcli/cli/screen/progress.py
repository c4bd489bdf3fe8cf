"""How long work is shown: a bar with rate and time to go on a terminal, lines elsewhere."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

from depthcli.cli.screen import console
from depthcli.core.text import one_line

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.progress import Progress as Bars

_LINE_EVERY_S = 10.0
_BAR_EVERY_S = 0.2


class Stage:
    """Work of one kind, which nobody looks at.

    Attributes:
        note: what is said behind rate and time to go.
    """

    def __init__(self, what: str, total: int | None, unit: str) -> None:
        self.note = ""
        self._what = one_line(what)
        self._total = total
        self._per_second = f" {unit}/s" if unit else "/s"
        self._done = self._skipped = 0
        self._start_s = self._shown_s = time.monotonic()

    def __call__(self, count: int) -> None:
        """So many units more are done."""
        self._done += count

    def skip(self, count: int) -> None:
        """So many are done that took no time, and say nothing of the others."""
        self._skipped += count
        self(count)

    def _is_due(self, every_s: float) -> bool:
        """Whether it was not shown for so long; then it counts as shown."""
        now_s = time.monotonic()
        if now_s - self._shown_s < every_s:
            return False
        self._shown_s = now_s
        return True

    def _speed(self) -> str:
        """Units a second, the time that the rest will take, and the note."""
        worked = self._done - self._skipped
        rate = worked / max(time.monotonic() - self._start_s, 1e-9)
        parts = [f"{rate:.1f}{self._per_second}"]
        if self._total is not None and worked:
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
            console.note(f"{name}{self._done}{of}  {self._speed()}")


class _Bar(Stage):
    """One bar among those on the terminal."""

    def __init__(self, bars: Bars, what: str, total: int | None, unit: str) -> None:
        super().__init__(what, total, unit)
        self._bars = bars
        self._task = bars.add_task(self._what, total=total, speed="")
        bars.refresh()

    def __call__(self, count: int) -> None:
        super().__call__(count)
        if self._is_due(_BAR_EVERY_S) or self._done == self._total:
            self._bars.update(self._task, completed=self._done, speed=self._speed(), refresh=True)


class Drawing:
    """A :class:`depthcli.core.progress.Progress` on standard error."""

    def __init__(self, bars: Bars | None, *, silent: bool, announces: bool) -> None:
        self._bars, self._silent, self._announces = bars, silent, announces

    def begin(self, what: str, total: int | None, unit: str = "") -> Stage:
        """Announce a stage, which is to be told of each unit that is done."""
        if self._silent:
            return Stage(what, total, unit)
        if self._bars is not None:
            return _Bar(self._bars, what, total, unit)
        if self._announces:
            console.note(what if total is None else f"{what}: {total}")
        return _Line(what, total, unit)


@contextmanager
def drawn(*, silent: bool, announces: bool = False) -> Iterator[Drawing]:
    """Progress for as long as the work takes; nothing if it is silent.

    Where there is no terminal, it may also announce each stage in a line at its beginning.
    """
    if silent or not sys.stderr.isatty():
        yield Drawing(None, silent=silent, announces=announces)
        return
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[speed]}", markup=False),
    )
    with console.bar(*columns) as bars:
        yield Drawing(bars, silent=False, announces=False)
