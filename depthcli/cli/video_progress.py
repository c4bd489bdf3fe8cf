"""How far a video is: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

from depthcli.cli.screen import console

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_LINE_EVERY_S = 10.0
_BAR_EVERY_S = 0.2


@contextmanager
def progress_for(name: str, *, silent: bool) -> Iterator[Callable[[int, int | None], None]]:
    """What to call after each frame, with frames done and frames in all if they are known.

    Args:
        name: the video.
        silent: show nothing.
    """
    if silent:
        yield lambda _done, _total: None
    elif sys.stderr.isatty():
        with _bar(name) as update:
            yield update
    else:
        yield _Lines(name)


@contextmanager
def _bar(name: str) -> Iterator[Callable[[int, int | None], None]]:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    rate = TextColumn("{task.fields[rate]:.1f} frames/s")
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        rate,
        TimeRemainingColumn(),
    )
    with console.bar(*columns) as bar:
        task = bar.add_task(console.one_line(name), total=None, rate=0.0)
        start = shown = time.monotonic()

        def update(done: int, total: int | None) -> None:
            nonlocal shown
            now = time.monotonic()
            if now - shown >= _BAR_EVERY_S or done == total:
                shown = now
                bar.update(task, completed=done, total=total, rate=done / max(now - start, 1e-9))

        yield update


class _Lines:
    """One line every ten seconds on standard error."""

    def __init__(self, name: str) -> None:
        self._name = console.one_line(name)
        self._start = self._shown = time.monotonic()

    def __call__(self, done: int, total: int | None) -> None:
        now = time.monotonic()
        if now - self._shown < _LINE_EVERY_S:
            return
        self._shown = now
        rate = done / (now - self._start)
        of, to_go = "", ""
        if total is not None:
            of, to_go = f"/{total}", f"  {max(0, total - done) / rate:.0f} s to go"
        console.note(f"{self._name}: frame {done}{of}  {rate:.1f} frames/s{to_go}")
