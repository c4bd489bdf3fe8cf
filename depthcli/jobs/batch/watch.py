"""Waiting for new and changed inputs of a folder."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from threading import Event
from typing import TypeAlias

from watchfiles import watch

from depthcli.io.listing import NameFilter, list_folder

_SETTLE_S = 1.0
_LOOK_MS = 500


_Stamp: TypeAlias = tuple[int, int, int]
"""Size, time of the last change in nanoseconds, and inode of a file."""


class FolderChanges:
    """Images and videos of a folder tree that are new or changed since the start or the last look.

    The output folder ``out`` is left out.
    """

    def __init__(self, root: str, out: str, names_filter: NameFilter) -> None:
        self._root, self._out, self._names_filter = root, out, names_filter
        self._seen = self._stamps()

    def wait(self, stop: Event) -> Iterator[tuple[set[str], list[str]]]:
        """Names of the new and changed inputs, and of all, until ``stop`` is set.

        A file is new or changed when its size and time have stayed the same for a second, so that
        it is complete.
        """
        since_s: dict[tuple[str, _Stamp], float] = {}
        is_first = True  # what came before the folder was watched is no change of it
        for changes in watch(
            self._root,
            stop_event=stop,
            rust_timeout=_LOOK_MS,
            yield_on_timeout=True,
            raise_interrupt=False,
        ):
            if not (changes or since_s or is_first):
                continue
            is_first, now_s = False, time.monotonic()
            stamps = self._stamps()
            new = stamps.items() - self._seen.items()
            since_s = {file: since_s.get(file, now_s) for file in new}
            settled = dict(file for file, at_s in since_s.items() if now_s - at_s >= _SETTLE_S)
            self._seen |= settled
            if settled:
                yield set(settled), list(stamps)

    def _stamps(self) -> dict[str, _Stamp]:
        stamps = {}
        for file in list_folder(
            self._root, leave_out=self._out, skip=self._names_filter.excludes
        ).media:
            if file.problem is None and self._names_filter.refusal(file.name) is None:
                try:
                    status = os.stat(file.path)  # noqa: PTH116 - a path as text
                except OSError:
                    continue  # it has gone again
                stamps[file.name] = status.st_size, status.st_mtime_ns, status.st_ino
        return stamps
