"""The journal of a running batch, from which a killed batch can be resumed.

Rows are appended line by line to a hidden file, not kept in memory. When the batch ends without
being killed, they are written to the manifest atomically.
"""

import os
import sqlite3
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

from depthcli.errors import OutputError, UsageError
from depthcli.io.manifest.files import (
    WHOLE,
    ManifestRow,
    RowFile,
    RowsFolder,
    Shard,
    is_journal,
    row_files,
    write_manifest,
)
from depthcli.io.storage.temporary import folder_lock, open_locked

_CACHE_KIB = 65536


_SCHEMA = (
    f"PRAGMA cache_size = -{_CACHE_KIB}",
    "PRAGMA journal_mode = OFF",
    "CREATE TABLE rows (name BLOB PRIMARY KEY, source INT, position INT) WITHOUT ROWID",
    "CREATE TABLE outputs (path BLOB PRIMARY KEY) WITHOUT ROWID",
    "BEGIN",
)


class Rows:
    """Rows of files by input; the last one of an input counts. Thread-safe.

    Their places (file, position) are in an SQLite database: in memory up to a few megabytes, then
    in a temporary file that is deleted with the process.
    """

    def __init__(
        self, files: Sequence[RowFile], shard: Shard = WHOLE, folder: RowsFolder | None = None
    ) -> None:
        """Index the rows of a shard's inputs, and keep the folder while they are in use."""
        self._files, self._folder = files, folder
        self._lock = threading.Lock()
        self._database = sqlite3.connect("", check_same_thread=False, isolation_level=None)
        for line in _SCHEMA:
            self._database.execute(line)
        for source, file in enumerate(files):
            self._index((name, source, at) for name, at in file.rows() if shard.holds(name))

    @property
    def has_files(self) -> bool:
        """Whether there is any file of rows."""
        return bool(self._files)

    def row(self, name: str) -> ManifestRow | None:
        """The row of an input, if it has one."""
        query = "SELECT source, position FROM rows WHERE name = ?"
        with self._lock:
            place = self._database.execute(query, (_key(name),)).fetchone()
            return None if place is None else self._at(place)

    def __iter__(self) -> Iterator[ManifestRow]:
        query = "SELECT source, position FROM rows ORDER BY 1, 2"
        return filter(None, map(self._at, self._database.execute(query)))

    def _index(self, rows: Iterable[tuple[str, int, int]]) -> None:
        """Set the places of the rows of inputs, replacing earlier ones."""
        values = ((_key(name), *place) for name, *place in rows)
        self._database.executemany("INSERT OR REPLACE INTO rows VALUES (?, ?, ?)", values)

    def _at(self, place: tuple[int, int]) -> ManifestRow | None:
        source, position = place
        return self._files[source].row(position)


def _key(name: str) -> bytes:
    return name.encode("utf-8", "surrogatepass")


def known_rows(folder: Path, shard: Shard = WHOLE) -> Rows:
    """The rows of earlier batches in an output folder, which is not changed."""
    source = RowsFolder(folder)
    with _as_output_error(folder):
        return Rows([RowFile(path) for path in row_files(source.path, shard)], shard, source)


class Journal(Rows):
    """The rows of a running batch.

    Attributes:
        manifest: the file that the rows are written to at the end.
        was_interrupted: whether an earlier batch was killed and no other one is running.
    """

    def __init__(self, folder: Path, shard: Shard = WHOLE) -> None:
        """Open or create the journal of an output folder, which is created if it is missing."""
        self._path = folder / shard.journal_name
        self.manifest = folder / shard.manifest_name
        self._shard = shard
        with ExitStack() as opened, _as_output_error(self._path):
            folder.mkdir(parents=True, exist_ok=True)
            if not opened.enter_context(folder_lock(folder, shared=shard != WHOLE)):
                raise _busy_error(folder)
            files = row_files(folder, shard)
            self.was_interrupted = shard == WHOLE and any(map(is_journal, files))
            self._earlier = [path for path in files if path != self._path]
            earlier = [opened.enter_context(closing(RowFile(path))) for path in self._earlier]
            handle = open_locked(self._path)
            if handle is None:
                raise _busy_error(folder)
            self._own = opened.enter_context(closing(RowFile(self._path, handle)))
            super().__init__([*earlier, self._own], shard)
            self._opened = opened.pop_all()

    def add(self, row: ManifestRow) -> None:
        """Append a row, which replaces the input's earlier one."""
        with _as_output_error(self._path), self._lock:
            position = self._own.append(row.as_line())
            self._index([(row.input, len(self._files) - 1, position)])

    def finish(self, names: Iterable[str] | None, *, keep_failed: bool = False) -> None:
        """Write the manifest and remove the journal.

        Inputs of earlier batches that have outputs here come last, so that they are not done again
        after a batch of other files of the same folder, unless an output is now that of another
        input. The rows of shards become part of the manifest of a batch that is not divided.

        Names are those of the inputs in the manifest's order; None for all, in the order of their
        names. After a batch of a part of the files, failed inputs of earlier batches are kept.
        """
        write_manifest(self.manifest, self._rows(names, keep_failed=keep_failed))
        with _as_output_error(self._path), self._opened:
            self._path.unlink(missing_ok=True)  # before another batch can lock it
            for path in self._earlier:
                if path != self.manifest and self._shard.owns(path):
                    path.unlink(missing_ok=True)

    def _rows(self, names: Iterable[str] | None, *, keep_failed: bool) -> Iterator[ManifestRow]:
        """Rows of the names in their order, each once, then the others that still hold."""
        execute, executemany = self._database.execute, self._database.executemany
        for name in names or ():
            row = self.row(name)
            if row is not None:
                paths = ((_key(file.path),) for file in row.outputs)
                executemany("INSERT OR IGNORE INTO outputs VALUES (?)", paths)
                yield row
                execute("DELETE FROM rows WHERE name = ?", (_key(name),))
        taken = "SELECT 1 FROM outputs WHERE path = ?"
        for place in execute("SELECT source, position FROM rows ORDER BY name"):
            row = self._at(place)
            if row is None or any(
                execute(taken, (_key(file.path),)).fetchone() for file in row.outputs
            ):
                continue
            if row.outputs or keep_failed or names is None:
                yield row


@contextmanager
def _as_output_error(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        where = os.fspath(error.filename or path)
        reason = error.strerror or str(error)
        raise OutputError(f"cannot write {where}: {reason}", "choose another {out}") from error


def _busy_error(folder: Path) -> UsageError:
    return UsageError(
        f"another batch is writing to {folder}", "wait for it, or choose another {out}"
    )
