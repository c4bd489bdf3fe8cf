"""Waiting for new and changed inputs of a folder."""

from __future__ import annotations

import os
from collections.abc import Iterator
from threading import Event
from typing import TypeAlias

from watchfiles import watch

from depthcli.io.listing.folder import NameFilter, list_folder

_SETTLE_MS = 1000


_Stamp: TypeAlias = tuple[int, int, int]
"""Size, time of the last change in nanoseconds, and inode of a file."""


class FolderChanges:
    """Images and videos of a folder tree that are new or changed since the start or the last look.

    The output folder ``out`` is left out.
    """

    def __init__(self, root: str, out: str, wanted: NameFilter) -> None:
        self._root, self._out, self._wanted = root, out, wanted
        self._seen = self._stamps()

    def wait(self, stop: Event) -> Iterator[list[str]]:
        """Names of inputs whose size and time have not changed for a second, until ``stop`` is set.

        A file that is still being written is given when it is complete.
        """
        unsettled: dict[str, _Stamp] = {}
        is_first = True  # what came before the folder was watched is no change of it
        for changes in watch(
            self._root,
            stop_event=stop,
            rust_timeout=_SETTLE_MS,
            yield_on_timeout=True,
            raise_interrupt=False,
        ):
            if not (changes or unsettled or is_first):
                continue
            is_first = False
            found = {
                name: stamp
                for name, stamp in self._stamps().items()
                if self._seen.get(name) != stamp
            }
            settled = {name: stamp for name, stamp in found.items() if unsettled.get(name) == stamp}
            unsettled = {name: stamp for name, stamp in found.items() if name not in settled}
            self._seen |= settled
            if settled:
                yield sorted(settled)

    def _stamps(self) -> dict[str, _Stamp]:
        stamps = {}
        for file in list_folder(self._root, leave_out=self._out, skip=self._wanted.excludes).media:
            if file.problem is None and self._wanted.refusal(file.name) is None:
                try:
                    found = os.stat(file.path)  # noqa: PTH116 - a path as text
                except OSError:
                    continue  # it has gone again
                stamps[file.name] = found.st_size, found.st_mtime_ns, found.st_ino
        return stamps
