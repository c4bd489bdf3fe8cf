"""How a batch is shown: a bar on a terminal, a line now and then elsewhere, or JSON."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

from depthcli.cli.screen import console

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from depthcli.jobs.batch.pictures import Result

_LINE_EVERY_S = 10.0
_BAR_EVERY_S = 0.2


class Tally:
    """What became of the inputs so far.

    Attributes:
        total: inputs in all.
        done: inputs worked on, the failed ones too.
        kept: inputs whose outputs of an earlier run are still right.
        failures: name and reason of those that failed.
        warning_count: warnings told so far.
    """

    def __init__(self, total: int) -> None:
        self.total = total
        self.done = 0
        self.kept = 0
        self.failures: list[tuple[str, str]] = []
        self._start_s = time.monotonic()

    def add(self, result: Result) -> None:
        """Count an input."""
        self.kept += result.is_kept
        self.done += not result.is_kept
        if result.row.error is not None:
            self.failures.append((result.row.input, result.row.error))

    @property
    def passed(self) -> int:
        """Inputs that are over with."""
        return self.done + self.kept

    @property
    def elapsed_s(self) -> float:
        """Seconds since the beginning."""
        return time.monotonic() - self._start_s

    @property
    def rate(self) -> float:
        """Inputs a second; those kept took no time and do not count."""
        return self.done / max(self.elapsed_s, 1e-9)

    @property
    def to_go_s(self) -> float | None:
        """Seconds that the rest will take, if nothing more is kept."""
        return (self.total - self.passed) / self.rate if self.done else None


@contextmanager
def progress_for(tally: Tally, *, silent: bool) -> Iterator[Callable[[], None]]:
    """What to call after each input."""
    if silent:
        yield lambda: None
    elif sys.stderr.isatty():
        with _bar(tally) as update:
            yield update
    else:
        yield _Lines(tally)


@contextmanager
def _bar(tally: Tally) -> Iterator[Callable[[], None]]:
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn

    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.description}", markup=False),
    )
    shown_s = 0.0
    # Refreshed from here alone: a thread that redraws would take turns from the workers.
    with console.bar(*columns, auto_refresh=False) as bar:
        task = bar.add_task("", total=tally.total)

        def update() -> None:
            nonlocal shown_s
            now_s = time.monotonic()
            if now_s - shown_s >= _BAR_EVERY_S or tally.passed == tally.total:
                shown_s = now_s
                bar.update(task, completed=tally.passed, description=_speed(tally), refresh=True)

        yield update


class _Lines:
    """One line every ten seconds on standard error."""

    def __init__(self, tally: Tally) -> None:
        self._tally = tally
        self._shown_s = time.monotonic()

    def __call__(self) -> None:
        now_s = time.monotonic()
        if now_s - self._shown_s >= _LINE_EVERY_S:
            self._shown_s = now_s
            console.note(f"{self._tally.passed}/{self._tally.total}  {_speed(self._tally)}")


def _speed(tally: Tally) -> str:
    parts = [f"{tally.rate:.1f} inputs/s"]
    if tally.to_go_s is not None:
        minutes, seconds = divmod(round(tally.to_go_s), 60)
        parts.append(f"{minutes}:{seconds:02} to go")
    if tally.failures:
        parts.append(f"{len(tally.failures)} failed")
    return "  ".join(parts)
