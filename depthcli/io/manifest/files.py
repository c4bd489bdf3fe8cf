"""The files of rows in an output folder: manifests and journals, of a whole batch or a shard."""

import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO, FileIO
from pathlib import Path
from typing import Any, BinaryIO, Protocol, Self

from depthcli.errors import UsageError
from depthcli.io.manifest.row import ManifestFormat, Origin, Row, parse_row, row_of
from depthcli.io.parquet import Table, write_table
from depthcli.io.storage.atomic import append_whole, atomic_folder, atomic_path
from depthcli.io.storage.paths import regular_size

_COLUMNS = {
    "input": str,
    "status": str,
    "outputs": [{"path": str, "bytes": int, "sha256": str}],
    "seconds": float,
    "input_sha256": str,
    "input_path": str,
    "error": str,
    "warnings": [str],
    "camera": str,
    "anchors": {"given": int, "used": int, "residual_m": float, "sha256": str},
    **dict.fromkeys(Origin.__slots__, str),
}
_ESCAPED = re.compile(r"\\u(d[89a-f][0-9a-f]{2})")


def write_rows(folder: Path, rows: Iterable[Row]) -> None:
    """Write a manifest in Parquet files, in place of one that is there.

    Raises:
        OutputError: it cannot be written; what was there stays.
    """
    with atomic_folder(folder) as temporary:
        write_table(temporary, _COLUMNS, (_utf8(row.as_json()) for row in rows))


def parsed_table_row(fields: dict[str, Any]) -> Row | None:
    """A row from the values of its columns; None if they are not those of a row."""
    return row_of(_with_texts(fields, unescaped))


def unescaped(text: str) -> str:
    """A text with its escapes undone."""
    return _ESCAPED.sub(lambda found: chr(int(found[1], 16)), text) if "\\u" in text else text


def _utf8(value: Any) -> Any:  # noqa: ANN401 - what JSON can hold
    """The same, with texts whose bytes are not UTF-8 escaped as in JSON."""
    return _with_texts(value, lambda text: text.encode("utf-8", "backslashreplace").decode())


def _with_texts(value: Any, change: Callable[[str], str]) -> Any:  # noqa: ANN401 - what JSON can hold
    """The same, with all texts changed."""
    if isinstance(value, str):
        return change(value)
    if isinstance(value, Mapping):
        return {name: _with_texts(part, change) for name, part in value.items()}
    if isinstance(value, Sequence):
        return [_with_texts(part, change) for part in value]
    return value


@dataclass(frozen=True, slots=True)
class Shard:
    """One of ``count`` parts; every input is in exactly one of them.

    The part is ``1 + H % count``, H being the first eight bytes of the SHA-256 of the input's name
    as a big-endian number: it depends on the name alone, on any machine and in any version.
    """

    number: int = 1  #: 1 to ``count``
    count: int = 1  #: how many parts there are; 1 for a batch that is not divided

    @classmethod
    def parse(cls, word: str) -> Self:
        """From ``2/4``.

        Raises:
            UsageError: it is something else, or there is no such part.
        """
        numbers = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", word)
        shard = cls(*map(int, numbers.groups())) if numbers else cls(0, 0)
        if not 1 <= shard.number <= shard.count:
            raise UsageError(f"--shard {word} is not I/N with I from 1 to N, such as 2/4")
        return shard

    def holds(self, name: str) -> bool:
        """Whether an input of this name, with ``/`` between its parts, is in this part."""
        if self.count == 1:
            return True
        digest = hashlib.sha256(os.fsencode(name)).digest()
        return int.from_bytes(digest[:8], "big") % self.count == self.number - 1

    @property
    def tag(self) -> str:
        """Infix for names of files that belong to this part."""
        return f"-{self.number}-of-{self.count}" if self.count > 1 else ""


WHOLE = Shard()


_PART_NAME = re.compile(r"part-\d{5}\.parquet")
_NO_DATA = {".DS_Store", "Thumbs.db", "desktop.ini", "_SUCCESS"}
"""Files that other programs leave in folders."""
_NAME = re.compile(r"(?:(\.depthcli-batch)|manifest)(-\d+-of-(\d+))?\.(jsonl|parquet)")


def journal_name(shard: Shard) -> str:
    """Name of the file with the rows of a running batch."""
    return f".depthcli-batch{shard.tag}.jsonl"


def manifest_name(shard: Shard, form: ManifestFormat) -> str:
    """Name of the file with the rows of a finished batch."""
    return f"manifest{shard.tag}.{form}"


def belongs_to(path: Path, shard: Shard) -> bool:
    """Whether all rows of a file are of a shard's inputs."""
    found = _NAME.fullmatch(path.name)
    return found is not None and (shard.count == 1 or found[2] == shard.tag)


def is_journal(path: Path) -> bool:
    """Whether a file is the journal of a batch or of a part of one."""
    found = _NAME.fullmatch(path.name)
    return found is not None and found[1] is not None


def row_files(folder: Path, shard: Shard) -> list[Path]:
    """The files that can hold rows of a shard's inputs, the latest last.

    Those of other shards of the same number are left out, because they hold other inputs.
    """
    found = []
    for path in (*folder.glob("manifest*"), *folder.glob(".depthcli-batch*")):
        match = _NAME.fullmatch(path.name)
        is_others = match and match[3] == str(shard.count) and match[2] != shard.tag
        if match and not is_others and path.exists():
            found.append(path)
    return sorted(found, key=lambda path: (path.stat().st_mtime_ns, path.name))


def is_row_file(name: str) -> bool:
    """Whether a file or folder of this name can hold rows."""
    return _NAME.fullmatch(name) is not None


def open_row_file(path: Path) -> BinaryIO:
    """Open a file of rows for reading.

    Raises:
        OSError: it cannot be read, or is a pipe, a device or a folder.
    """
    regular_size(path)
    return path.open("rb")


def write_manifest(path: Path, rows: Iterable[Row]) -> None:
    """Write a manifest atomically, in the format of its suffix.

    Raises:
        OutputError: it cannot be written; what was there stays.
    """
    if path.suffix == f".{ManifestFormat.PARQUET}":
        write_rows(path, rows)
        return
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.writelines(row.as_line() for row in rows)


class RowFile(Protocol):
    """A file or folder of rows."""

    def rows(self) -> Iterator[tuple[str, int]]:
        """Input and position of each row, in their order; other lines are ignored."""

    def row(self, position: int) -> Row | None:
        """The row at a position."""

    def is_own(self) -> bool:
        """Whether depthcli wrote it; it is not empty."""

    def close(self) -> None:
        """Close it."""


def check_written_here(path: Path, rows: RowFile) -> None:
    """Check that a manifest that will be replaced was written by depthcli.

    Raises:
        UsageError: it was not.
    """
    if path.is_dir():
        parts = {part.name for part in path.iterdir()} - _NO_DATA
        is_own = all(map(_PART_NAME.fullmatch, parts))
        is_empty = not parts
    else:
        is_own, is_empty = True, not path.stat().st_size
    if not (is_own and (is_empty or rows.is_own())):
        raise UsageError(
            f"{path.name} in the output folder was not written by depthcli; move it away, or "
            "choose another --out"
        )


def open_rows(path: Path) -> RowFile:
    """Open a manifest or a journal for reading.

    Raises:
        OSError: they cannot be read.
        UsageError: they are in Parquet, and pyarrow is missing or a file is damaged.
    """
    if path.suffix == f".{ManifestFormat.PARQUET}":
        return TableRows(path)
    # A file of size 0, such as /proc/kmsg, may never end.
    return JsonRows(open_row_file(path) if regular_size(path) else BytesIO())


class TableRows:
    """Rows in Parquet files."""

    def __init__(self, folder: Path) -> None:
        self._table = Table(folder)

    def rows(self) -> Iterator[tuple[str, int]]:
        """Input and position of each row, in their order."""
        for position, name in enumerate(self._table.column("input")):
            if isinstance(name, str):
                yield unescaped(name), position

    def row(self, position: int) -> Row | None:
        """The row at a position."""
        return parsed_table_row(self._table.row(position))

    def is_own(self) -> bool:
        """Whether its files have the columns of rows."""
        return self._table.has_columns(("input", "status"))

    def close(self) -> None:
        """Close the files."""
        self._table.close()


class JsonRows:
    """Rows as JSON, one a line."""

    def __init__(self, file: BinaryIO, end: FileIO | None = None) -> None:
        """Wrap a file that is open for reading, and a second handle of it for appending."""
        self._file = file
        self._end = end
        self.ends_whole = True

    def rows(self) -> Iterator[tuple[str, int]]:
        """Input and position of each row, in their order; other lines are passed over."""
        position = self._file.seek(0)
        for line in self._file:
            row = parse_row(line)
            if row is not None:
                yield row.input, position
            position += len(line)
            self.ends_whole = line.endswith(b"\n")

    def row(self, position: int) -> Row | None:
        """The row at a position."""
        self._file.seek(position)
        return parse_row(self._file.readline())

    def is_own(self) -> bool:
        """Whether a line is a row."""
        return next(self.rows(), None) is not None

    def append(self, data: bytes) -> int:
        """Append data, all or nothing; return its position in the file.

        Raises:
            OSError: it cannot be written.
        """
        if self._end is None:
            raise TypeError(self._end)
        return append_whole(self._end, data)

    def close(self) -> None:
        """Close the file."""
        self._file.close()
