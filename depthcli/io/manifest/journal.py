"""The journal of a running batch, from which a killed batch can be resumed.

Rows are appended line by line to a hidden file, not kept in memory. When the batch ends without
being killed, they are written to the manifest atomically.
"""

import errno
import os
import shutil
import sqlite3
import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import NamedTuple

from depthcli.errors import OutputError, UsageError
from depthcli.io.manifest.files import (
    WHOLE,
    JsonRows,
    RowFile,
    Shard,
    belongs_to,
    check_written_here,
    is_journal,
    journal_name,
    manifest_name,
    open_row_file,
    open_rows,
    row_files,
    write_manifest,
)
from depthcli.io.manifest.row import ManifestFormat, Row
from depthcli.io.manifest.rows_folder import RowsFolder, rows_folder
from depthcli.io.parquet import check_pyarrow
from depthcli.io.storage.atomic import restore_folder
from depthcli.io.storage.temporary import folder_lock, open_locked

_CACHE_KIB = 65536


class RowLocation(NamedTuple):
    """Where a row is."""

    source: int  #: number of the file
    position: int  #: of the row in it


class RowIndex:
    """Locations by input, in a temporary SQLite database that is deleted with the process."""

    def __init__(self) -> None:
        self._database = _database("name BLOB PRIMARY KEY, source INT, position INT")

    def add(self, locations: Iterable[tuple[str, RowLocation]]) -> None:
        """Set the locations of the rows of inputs, replacing earlier ones.

        Raises:
            OutputError: the disk is full.
        """
        rows = ((_key(name), *location) for name, location in locations)
        with _as_disk_error():
            self._database.executemany("INSERT OR REPLACE INTO rows VALUES (?, ?, ?)", rows)

    def find(self, name: str) -> RowLocation | None:
        """The location of an input's row; None if it has none."""
        found = self._database.execute(
            "SELECT source, position FROM rows WHERE name = ?", (_key(name),)
        ).fetchone()
        return found and RowLocation(*found)

    def remove(self, name: str) -> None:
        """Remove an input from the index."""
        self._database.execute("DELETE FROM rows WHERE name = ?", (_key(name),))

    def in_file_order(self) -> Iterator[RowLocation]:
        """All locations, by file and position."""
        found = self._database.execute("SELECT source, position FROM rows ORDER BY 1, 2")
        return (RowLocation(*location) for location in found)

    def __iter__(self) -> Iterator[RowLocation]:
        """All locations, sorted by the names' bytes."""
        found = self._database.execute("SELECT source, position FROM rows ORDER BY name")
        return (RowLocation(*location) for location in found)


class PathIndex:
    """A set of paths, in such a database."""

    def __init__(self) -> None:
        self._database = _database("path BLOB PRIMARY KEY")

    def add(self, paths: Iterable[str]) -> None:
        """Add paths.

        Raises:
            OutputError: the disk is full.
        """
        with _as_disk_error():
            self._database.executemany(
                "INSERT OR IGNORE INTO rows VALUES (?)", ((_key(path),) for path in paths)
            )

    def __contains__(self, path: str) -> bool:
        """Whether a path is in the set."""
        found = self._database.execute("SELECT 1 FROM rows WHERE path = ?", (_key(path),))
        return found.fetchone() is not None


def _database(columns: str) -> sqlite3.Connection:
    # Without a name the database is in memory as far as its cache goes, then in a file.
    database = sqlite3.connect("", check_same_thread=False, isolation_level=None)
    for line in (
        f"PRAGMA cache_size = -{_CACHE_KIB}",
        "PRAGMA journal_mode = OFF",
        f"CREATE TABLE rows ({columns}) WITHOUT ROWID",
        "BEGIN",
    ):
        database.execute(line)
    return database


@contextmanager
def _as_disk_error() -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        raise OutputError(
            f"cannot index the rows of earlier batches in a temporary file: {error}; set "
            "SQLITE_TMPDIR to a folder with room"
        ) from error


def _key(name: str) -> bytes:
    return name.encode("utf-8", "surrogatepass")


class Rows:
    """Rows of files by input; the last one of an input counts. Thread-safe."""

    def __init__(
        self, files: Sequence[RowFile], shard: Shard, folder: RowsFolder | None = None
    ) -> None:
        """Index the rows of a shard's inputs.

        Args:
            files: with the rows.
            shard: the shard whose rows are indexed.
            folder: that has them, to be kept while they are in use.
        """
        self._files = files
        self._folder = folder
        self._lock = threading.Lock()
        self._index = RowIndex()
        for source, file in enumerate(files):
            self._index.add(
                (name, RowLocation(source, position))
                for name, position in file.rows()
                if shard.holds(name)
            )

    @property
    def has_files(self) -> bool:
        """Whether there is any file of rows."""
        return bool(self._files)

    def row(self, name: str) -> Row | None:
        """The row of an input, if it has one."""
        with self._lock:
            location = self._index.find(name)
            return None if location is None else self._at(location)

    def __iter__(self) -> Iterator[Row]:
        """All rows, in the order of the files."""
        return filter(None, map(self._at, self._index.in_file_order()))

    def _at(self, location: RowLocation) -> Row | None:
        try:
            return self._files[location.source].row(location.position)
        except OSError as error:
            raise OutputError(
                f"cannot read the rows of the batch again: {error.strerror}; run it again when the "
                "disk can be read"
            ) from error


def known_rows(folder: Path, shard: Shard = WHOLE) -> Rows:
    """The rows of earlier batches in an output folder, which is not changed.

    Raises:
        OutputError: it cannot be read.
        UsageError: a manifest there was not written by depthcli.
    """
    source = rows_folder(folder)
    with _as_output_error(folder):
        return Rows(_opened_rows(row_files(source.path, shard)), shard, source)


def _opened_rows(paths: Iterable[Path]) -> list[RowFile]:
    files = []
    for path in paths:
        files.append(open_rows(path))
        if not is_journal(path):
            check_written_here(path, files[-1])
    return files


class Journal(Rows):
    """The rows of a running batch.

    Attributes:
        manifest: the file that the rows are written to at the end.
        was_interrupted: whether an earlier batch was killed and no other one is running.
    """

    def __init__(
        self, folder: Path, shard: Shard = WHOLE, form: ManifestFormat | None = None
    ) -> None:
        """Open or create the journal of an output folder, which is created if it is missing.

        Args:
            folder: the output folder.
            shard: the part of a batch whose rows these are.
            form: of the manifest; None for that of the manifest that is there, or JSON lines.

        Raises:
            OutputError: the folder cannot be written, or something other than a file is in the way.
            UsageError: another batch, not a shard of the same one, is writing there, or a manifest
                there was not written by depthcli.
        """
        self._path = folder / journal_name(shard)
        lines, table = (folder / manifest_name(shard, one) for one in ManifestFormat)
        with ExitStack() as opened, _as_output_error(self._path):
            folder.mkdir(parents=True, exist_ok=True)
            if not opened.enter_context(folder_lock(folder, shared=shard != WHOLE)):
                raise _busy_error(folder)
            restore_folder(table)
            if lines.is_symlink():
                raise FileExistsError(errno.EEXIST, "it is a link; remove it", lines)
            if table.is_symlink() or table.is_file():
                raise NotADirectoryError(errno.ENOTDIR, "it is a file or a link; remove it", table)
            form = form or (ManifestFormat.PARQUET if table.exists() else ManifestFormat.JSONL)
            if form == ManifestFormat.PARQUET:
                check_pyarrow()
            self.manifest = folder / manifest_name(shard, form)
            self._earlier = [path for path in row_files(folder, shard) if path != self._path]
            self.was_interrupted = shard == WHOLE and any(
                map(is_journal, (*self._earlier, *([self._path] if self._path.exists() else [])))
            )
            files = [opened.enter_context(closing(file)) for file in _opened_rows(self._earlier)]
            handle = open_locked(self._path)
            if handle is None:
                raise _busy_error(folder)
            end = opened.enter_context(os.fdopen(handle, "ab", buffering=0))
            self._own = JsonRows(opened.enter_context(open_row_file(self._path)), end)
            super().__init__([*files, self._own], shard)
            if not self._own.ends_whole:  # the batch was killed in the middle of a line
                self._own.append(b"\n")
            self._opened = opened.pop_all()
        self._shard = shard

    def add(self, row: Row) -> None:
        """Append a row, which replaces the input's earlier one.

        Raises:
            OutputError: it cannot be written, for instance because the disk is full.
        """
        with _as_output_error(self._path), self._lock:
            location = RowLocation(len(self._files) - 1, self._own.append(row.as_line()))
            self._index.add([(row.input, location)])

    def finish(self, names: Iterable[str] | None, *, keep_failed: bool = False) -> None:
        """Write the manifest and remove the journal.

        Inputs of earlier batches that have outputs here come last, so that they are not done again
        after a batch of other files of the same folder, unless an output is now that of another
        input. The rows of shards become part of the manifest of a batch that is not divided.

        Args:
            names: the inputs in the manifest's order; those without a row are left out. None for
                all inputs, in the order of their names.
            keep_failed: keep failed inputs of earlier batches, too, as after a batch of a part of
                the files.

        Raises:
            OutputError: the manifest cannot be written; the journal stays.
        """
        write_manifest(self.manifest, self._rows(names, keep_failed=keep_failed))
        with _as_output_error(self._path):
            if sys.platform == "win32":  # which removes nothing that is open
                self._opened.close()
            self._path.unlink(missing_ok=True)  # before another batch can lock it
            for path in self._earlier:
                if path != self.manifest and belongs_to(path, self._shard):
                    remove_path(path)
            self._opened.close()

    def _rows(self, names: Iterable[str] | None, *, keep_failed: bool) -> Iterator[Row]:
        """Those of the names, in their order and each once, then the others that still hold."""
        written = PathIndex()
        for name in names or ():
            row = self.row(name)
            if row is not None:
                written.add(file.path for file in row.outputs)
                yield row
                self._index.remove(name)
        for location in self._index:
            row = self._at(location)
            if row is None or any(file.path in written for file in row.outputs):
                continue
            if row.outputs or keep_failed or names is None:
                yield row


@contextmanager
def _as_output_error(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        where = os.fspath(error.filename or path)
        raise OutputError(f"cannot write {where}: {reason}; choose another --out") from error


def remove_path(path: Path) -> None:
    """Remove a file or a folder."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _busy_error(folder: Path) -> UsageError:
    return UsageError(f"another batch is writing to {folder}; wait for it, or choose another --out")
