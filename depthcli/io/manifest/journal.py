"""The rows of a batch while it runs: safe line by line, so that a killed batch can go on.

Rows are appended to a hidden file and live there, not in memory. When the batch ends, in whatever
orderly way, they become the manifest, which appears whole.
"""

import errno
import os
import shutil
import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

from depthcli.errors import OutputError, UsageError
from depthcli.io.manifest.files import (
    JsonRows,
    RowFile,
    is_journal,
    is_of,
    journal_name,
    manifest_name,
    open_rows,
    row_files,
    to_read,
    write_manifest,
)
from depthcli.io.manifest.index import RowIndex, RowPlace
from depthcli.io.manifest.row import ManifestFormat, Row
from depthcli.io.manifest.rows_folder import RowsFolder, rows_folder
from depthcli.io.manifest.shard import WHOLE, Shard
from depthcli.io.parquet import check_pyarrow
from depthcli.io.storage.atomic_folder import put_back
from depthcli.io.storage.lock import folder_lock, open_locked


class Rows:
    """Rows by input as files have them; the last one of an input counts. Safe for threads."""

    def __init__(
        self, files: Sequence[RowFile], shard: Shard, place: RowsFolder | None = None
    ) -> None:
        """Index the rows of a shard's inputs.

        Args:
            files: where they are.
            shard: whose they are.
            place: the folder of the files, if that shall not go before them.
        """
        self._files = files
        self._place = place
        self._lock = threading.Lock()
        self._index = RowIndex()
        for source, file in enumerate(files):
            self._index.add(
                (name, RowPlace(source, position))
                for name, position in file.rows()
                if shard.holds(name)
            )

    @property
    def is_there(self) -> bool:
        """Whether there is a file of rows at all."""
        return bool(self._files)

    def row(self, name: str) -> Row | None:
        """The row of an input, if it has one."""
        with self._lock:
            place = self._index.find(name)
            return None if place is None else self._at(place)

    def __iter__(self) -> Iterator[Row]:
        """All rows, as they stand in the files."""
        return filter(None, map(self._at, self._index.as_they_stand()))

    def _at(self, place: RowPlace) -> Row | None:
        try:
            return self._files[place.source].row(place.position)
        except OSError as error:
            raise OutputError(
                f"cannot read the rows of the batch again: {error.strerror}; run it again when the "
                "disk can be read"
            ) from error


def known_rows(folder: Path, shard: Shard = WHOLE) -> Rows:
    """What earlier batches left in an output folder, without changing anything there.

    Raises:
        OutputError: it cannot be read.
    """
    place = rows_folder(folder)
    with _as_output_error(folder):
        return Rows([open_rows(path) for path in row_files(place.path, shard)], shard, place)


class Journal(Rows):
    """The rows of a batch at work.

    Attributes:
        manifest: the file that the rows become.
        was_cut_short: whether an earlier batch was killed and nobody else writes here.
    """

    def __init__(
        self, folder: Path, shard: Shard = WHOLE, form: ManifestFormat | None = None
    ) -> None:
        """Open or begin the journal of an output folder, which is made if it is missing.

        Args:
            folder: the output folder.
            shard: the part of a batch whose rows these are.
            form: of the manifest; None for that of the manifest that is there, or JSON lines.

        Raises:
            OutputError: the folder cannot be written, or something that is no file is in the way.
            UsageError: another batch is writing there; another shard of a divided one may.
        """
        self._path = folder / journal_name(shard)
        table = folder / manifest_name(shard, ManifestFormat.PARQUET)
        with ExitStack() as opened, _as_output_error(self._path):
            folder.mkdir(parents=True, exist_ok=True)
            if not opened.enter_context(folder_lock(folder, shared=shard != WHOLE)):
                raise _taken(folder)
            put_back(table)
            if table.is_symlink() or table.is_file():
                raise NotADirectoryError(errno.ENOTDIR, "it is a file or a link; remove it", table)
            form = form or (ManifestFormat.PARQUET if table.exists() else ManifestFormat.JSONL)
            if form == ManifestFormat.PARQUET:
                check_pyarrow()
            self.manifest = folder / manifest_name(shard, form)
            self._earlier = [path for path in row_files(folder, shard) if path != self._path]
            self.was_cut_short = shard == WHOLE and any(
                map(is_journal, (*self._earlier, *([self._path] if self._path.exists() else [])))
            )
            handle = open_locked(self._path)
            if handle is None:
                raise _taken(folder)
            end = opened.enter_context(os.fdopen(handle, "ab", buffering=0))
            files = [opened.enter_context(closing(open_rows(path))) for path in self._earlier]
            self._own = JsonRows(opened.enter_context(to_read(self._path)), end)
            super().__init__([*files, self._own], shard)
            if not self._own.ends_whole:  # the batch was killed in the middle of a line
                self._own.append(b"\n")
            self._opened = opened.pop_all()
        self._shard = shard

    def add(self, row: Row) -> None:
        """Put down a row, in place of the input's earlier one.

        Raises:
            OutputError: the disk is full, say.
        """
        with _as_output_error(self._path), self._lock:
            place = RowPlace(len(self._files) - 1, self._own.append(row.as_line()))
            self._index.add([(row.input, place)])

    def finish(self, names: Iterable[str] | None) -> None:
        """Write the manifest and remove the journal.

        Inputs of earlier batches come last, as long as they have outputs here: a batch of other
        files of the same folder must not make this one's be done again. What shards left becomes
        part of the manifest of a batch that is not divided.

        Args:
            names: the inputs in the manifest's order, those without a row are left out; None for
                all that there are, in the order of their names.

        Raises:
            OutputError: the manifest cannot be written; the journal stays.
        """
        write_manifest(self.manifest, self._rows(names))
        with _as_output_error(self._path):
            if sys.platform == "win32":  # which removes nothing that is open
                self._opened.close()
            self._path.unlink(missing_ok=True)  # before another batch can lock it
            for path in self._earlier:
                if path != self.manifest and is_of(path, self._shard):
                    remove_path(path)
            self._opened.close()

    def _rows(self, names: Iterable[str] | None) -> Iterator[Row]:
        """Those of the names, in their order and each once, then the others with outputs."""
        for name in names or ():
            row = self.row(name)
            if row is not None:
                yield row
                self._index.remove(name)
        for place in self._index:
            row = self._at(place)
            if row is not None and (row.outputs or names is None):
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


def _taken(folder: Path) -> UsageError:
    return UsageError(f"another batch is writing to {folder}; wait for it, or choose another --out")
