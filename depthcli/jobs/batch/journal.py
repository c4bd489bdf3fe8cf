"""The rows of a batch while it runs: safe line by line, so that a killed batch can go on.

Rows are appended to a hidden file and live there, not in memory. When the batch ends, in whatever
orderly way, they become the manifest, which appears whole.
"""

from __future__ import annotations

import os
import shutil
import threading
from contextlib import contextmanager
from io import BytesIO
from typing import TYPE_CHECKING, BinaryIO

from depthcli.errors import OutputError, UsageError
from depthcli.io.storage.atomic import atomic_path
from depthcli.jobs.batch.manifest import MANIFEST_NAME, parse_row

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from depthcli.jobs.batch.manifest import Row

JOURNAL_NAME = ".depthcli-batch.jsonl"


class Rows:
    """Rows by input as a file has them; the last one of an input counts. Safe for threads."""

    def __init__(self, file: BinaryIO) -> None:
        """Index a file that is open for reading."""
        self._file = file
        self._lock = threading.Lock()
        self._offsets: dict[str, int] = {}
        offset, self._ends_whole = 0, True
        for line in file:
            row = parse_row(line)
            if row is not None:
                self._offsets[row.input] = offset
            offset += len(line)
            self._ends_whole = line.endswith(b"\n")

    def row(self, name: str) -> Row | None:
        """The row of an input, if it has one."""
        line = self._line(name)
        return None if line is None else parse_row(line)

    def _line(self, name: str) -> bytes | None:
        with self._lock:
            offset = self._offsets.get(name)
            if offset is None:
                return None
            self._file.seek(offset)
            return self._file.readline()


def known_rows(folder: Path) -> Rows:
    """What earlier batches left in an output folder, without changing anything there."""
    for name in (JOURNAL_NAME, MANIFEST_NAME):
        try:
            return Rows((folder / name).open("rb"))
        except OSError:
            continue
    return Rows(BytesIO())


class Journal(Rows):
    """The rows of a batch at work.

    Attributes:
        was_cut_short: whether an earlier batch was killed.
    """

    def __init__(self, folder: Path) -> None:
        """Open or begin the journal of an output folder, which is made if it is missing.

        Raises:
            OutputError: the folder cannot be written.
            UsageError: another batch is writing there.
        """
        self._path = folder / JOURNAL_NAME
        self._manifest = folder / MANIFEST_NAME
        with self._explained():
            folder.mkdir(parents=True, exist_ok=True)
            self.was_cut_short = self._path.exists()
            if not self.was_cut_short and self._manifest.exists():
                with atomic_path(self._path) as temporary:
                    shutil.copyfile(self._manifest, temporary)
            file = self._path.open("a+b")
            _lock_file(file, folder)
            file.seek(0)
            super().__init__(file)
            if not self._ends_whole:  # the batch was killed in the middle of a line
                self._append(b"\n")

    def add(self, row: Row) -> None:
        """Put down a row, in place of the input's earlier one.

        Raises:
            OutputError: the disk is full, say.
        """
        with self._explained(), self._lock:
            self._offsets[row.input] = self._append(row.as_line())

    def finish(self, names: Iterable[str]) -> None:
        """Write the manifest and remove the journal.

        Inputs of earlier batches come last, as long as they have outputs here: a batch of other
        files of the same folder must not make this one's be done again.

        Args:
            names: the inputs in the manifest's order; those without a row are left out.

        Raises:
            OutputError: the manifest cannot be written; the journal stays.
        """
        wanted = dict.fromkeys(names)
        others = sorted(self._offsets.keys() - wanted.keys(), key=os.fsencode)
        with atomic_path(self._manifest) as temporary, temporary.open("wb") as manifest:
            for name in wanted:
                manifest.write(self._line(name) or b"")
            for name in others:
                row = self.row(name)
                if row is not None and row.outputs:
                    manifest.write(row.as_line())
        with self._explained():
            self._file.close()
            self._path.unlink(missing_ok=True)

    def _append(self, data: bytes) -> int:
        """Where the data begins in the file."""
        offset = self._file.seek(0, os.SEEK_END)
        self._file.write(data)
        self._file.flush()
        return offset

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            reason = error.strerror or str(error)
            raise OutputError(
                f"cannot write {self._path}: {reason}; choose another --out"
            ) from error


def remove_leftovers(folders: Iterable[Path]) -> None:
    """Remove the temporary files that a killed batch left in these folders."""
    for folder in folders:
        for path in folder.glob(".depthcli-*"):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name != JOURNAL_NAME:
                path.unlink(missing_ok=True)


def _lock_file(file: BinaryIO, folder: Path) -> None:
    """Keep a second batch out; the lock ends with the process, however it ends."""
    try:
        import fcntl  # noqa: PLC0415 - not on Windows
    except ImportError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise UsageError(
            f"another batch is writing to {folder}; wait for it, or choose another --out"
        ) from None
    except OSError:  # some network file systems have no locks
        return
