"""Where the row of each input stands; on disk beyond a few megabytes."""

import sqlite3
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from depthcli.errors import OutputError

_CACHE_KIB = 65536


class RowPlace(NamedTuple):
    """Where a row stands."""

    source: int  #: number of the file
    position: int  #: of the row in it


class RowIndex:
    """Places by input. The file is SQLite's own temporary one, which ends with the process."""

    def __init__(self) -> None:
        # Without a name the database is in memory as far as its cache goes, then in a file.
        self._database = sqlite3.connect("", check_same_thread=False, isolation_level=None)
        for line in (
            f"PRAGMA cache_size = -{_CACHE_KIB}",
            "PRAGMA journal_mode = OFF",
            "CREATE TABLE rows (name BLOB PRIMARY KEY, source INT, position INT) WITHOUT ROWID",
            "BEGIN",
        ):
            self._database.execute(line)

    def add(self, places: Iterable[tuple[str, RowPlace]]) -> None:
        """Put down where the rows of inputs stand, in place of where they stood.

        Raises:
            OutputError: there is no room.
        """
        rows = ((_key(name), *place) for name, place in places)
        try:
            self._database.executemany("INSERT OR REPLACE INTO rows VALUES (?, ?, ?)", rows)
        except sqlite3.Error as error:
            raise OutputError(
                f"cannot index the rows of earlier batches in a temporary file: {error}; set "
                "SQLITE_TMPDIR to a folder with room"
            ) from error

    def find(self, name: str) -> RowPlace | None:
        """Where the row of an input stands, if it has one."""
        found = self._database.execute(
            "SELECT source, position FROM rows WHERE name = ?", (_key(name),)
        ).fetchone()
        return found and RowPlace(*found)

    def remove(self, name: str) -> None:
        """Forget an input."""
        self._database.execute("DELETE FROM rows WHERE name = ?", (_key(name),))

    def as_they_stand(self) -> Iterator[RowPlace]:
        """All places, source by source and from its beginning to its end."""
        found = self._database.execute("SELECT source, position FROM rows ORDER BY 1, 2")
        return (RowPlace(*place) for place in found)

    def __iter__(self) -> Iterator[RowPlace]:
        """All places, in the order of the names' bytes."""
        found = self._database.execute("SELECT source, position FROM rows ORDER BY name")
        return (RowPlace(*place) for place in found)


def _key(name: str) -> bytes:
    return name.encode("utf-8", "surrogatepass")
