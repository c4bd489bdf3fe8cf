"""The rows of a batch while it runs: safe line by line, so that a killed batch can go on.

Rows are appended to a hidden file and live there, not in memory. When the batch ends, in whatever
orderly way, they become the manifest, which appears whole.
"""

from __future__ import annotations

import os
import shutil
import sys
import threading
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from depthcli.errors import OutputError, UsageError
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.storage.lock import lock, open_locked
from depthcli.jobs.batch.row_files import (
    JsonLines,
    is_journal,
    journal_name,
    manifest_name,
    row_files,
    to_read,
)
from depthcli.jobs.batch.row_index import Place, RowIndex
from depthcli.jobs.batch.shard import WHOLE, Shard

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from depthcli.jobs.batch.manifest import Row


class Rows:
    """Rows by input as files have them; the last one of an input counts. Safe for threads."""

    def __init__(self, files: Sequence[JsonLines], shard: Shard) -> None:
        """Index the rows of a shard's inputs."""
        self._files = files
        self._lock = threading.Lock()
        self._index = RowIndex()
        for source, file in enumerate(files):
            self._index.add(
                (name, Place(source, position))
                for name, position in file.rows()
                if shard.holds(name)
            )

    def row(self, name: str) -> Row | None:
        """The row of an input, if it has one."""
        with self._lock:
            place = self._index.find(name)
            return None if place is None else self._at(place)

    def _at(self, place: Place) -> Row | None:
        return self._files[place.source].row(place.position)


def known_rows(folder: Path, shard: Shard = WHOLE) -> Rows:
    """What earlier batches left in an output folder, without changing anything there.

    Raises:
        OutputError: it cannot be read.
    """
    with _explained(folder):
        return Rows([JsonLines(to_read(path)) for path in row_files(folder, shard)], shard)


class Journal(Rows):
    """The rows of a batch at work.

    Attributes:
        manifest: the file that the rows become.
        was_cut_short: whether an earlier batch was killed and nobody else writes here.
    """

    def __init__(self, folder: Path, shard: Shard = WHOLE) -> None:
        """Open or begin the journal of an output folder, which is made if it is missing.

        Raises:
            OutputError: the folder cannot be written, or something that is no file is in the way.
            UsageError: another batch is writing there; another shard of a divided one may.
        """
        self._path = folder / journal_name(shard)
        self.manifest = folder / manifest_name(shard)
        with ExitStack() as opened, _explained(self._path):
            folder.mkdir(parents=True, exist_ok=True)
            _keep_others_out(folder, opened, shard)
            self._earlier = [path for path in row_files(folder, shard) if path != self._path]
            self.was_cut_short = shard == WHOLE and any(
                map(is_journal, (*self._earlier, *([self._path] if self._path.exists() else [])))
            )
            handle = open_locked(self._path)
            if handle is None:
                raise _taken(folder)
            end = opened.enter_context(os.fdopen(handle, "ab", buffering=0))
            files = [opened.enter_context(to_read(p)) for p in (*self._earlier, self._path)]
            self._own = JsonLines(files.pop(), end)
            super().__init__([*map(JsonLines, files), self._own], shard)
            if not self._own.ends_whole:  # the batch was killed in the middle of a line
                self._own.append(b"\n")
            self._opened = opened.pop_all()
        self._shard = shard

    def add(self, row: Row) -> None:
        """Put down a row, in place of the input's earlier one.

        Raises:
            OutputError: the disk is full, say.
        """
        with _explained(self._path), self._lock:
            place = Place(len(self._files) - 1, self._own.append(row.as_line()))
            self._index.add([(row.input, place)])

    def finish(self, names: Iterable[str]) -> None:
        """Write the manifest and remove the journal.

        Inputs of earlier batches come last, as long as they have outputs here: a batch of other
        files of the same folder must not make this one's be done again. What shards left becomes
        part of the manifest of a batch that is not divided.

        Args:
            names: the inputs in the manifest's order; those without a row are left out.

        Raises:
            OutputError: the manifest cannot be written; the journal stays.
        """
        with atomic_path(self.manifest) as temporary, temporary.open("wb") as manifest:
            manifest.writelines(row.as_line() for row in self._rows(names))
        with _explained(self._path):
            if sys.platform == "win32":  # which removes nothing that is open
                self._opened.close()
            self._path.unlink(missing_ok=True)  # before another batch can lock it
            for path in self._earlier if self._shard == WHOLE else ():
                if path != self.manifest:
                    path.unlink(missing_ok=True)
            self._opened.close()

    def _rows(self, names: Iterable[str]) -> Iterator[Row]:
        """Those of the names, in their order and each once, then the others with outputs."""
        for name in names:
            row = self.row(name)
            if row is not None:
                yield row
                self._index.remove(name)
        for place in self._index:
            row = self._at(place)
            if row is not None and row.outputs:
                yield row


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"cannot write {path}: {reason}; choose another --out") from error


def remove_leftovers(folders: Iterable[Path]) -> None:
    """Remove the temporary files that a killed batch left in these folders."""
    for folder in folders:
        for path in folder.glob(".depthcli-*"):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif not is_journal(path):
                path.unlink(missing_ok=True)


def _keep_others_out(folder: Path, opened: ExitStack, shard: Shard) -> None:
    """Lock the output folder itself; other shards may be at work in it."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:  # Windows opens no folders
        return
    opened.callback(os.close, handle)
    if not lock(handle, shared=shard != WHOLE):
        raise _taken(folder)


def _taken(folder: Path) -> UsageError:
    return UsageError(f"another batch is writing to {folder}; wait for it, or choose another --out")
