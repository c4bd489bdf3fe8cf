"""An index of the rows by input, and one of paths; on disk beyond a few megabytes."""

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

from depthcli.errors import OutputError

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
