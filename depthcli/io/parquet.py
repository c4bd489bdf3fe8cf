"""Tables in Parquet files; the only module that imports pyarrow."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import accumulate, chain, count, islice
from typing import TYPE_CHECKING, Any

from depthcli.core.text import INSTALL_PYARROW, one_line
from depthcli.errors import UsageError

if TYPE_CHECKING:
    from pathlib import Path

    import pyarrow as pa
    import pyarrow.parquet as pq

_DEFAULT_COLUMN = "path"
_GROUP_ROWS = 8192
_PART_GROUPS = 128
_BLOCK_ROWS = 64


def check_pyarrow() -> None:
    """Check that Parquet files can be read and written.

    Raises:
        UsageError: pyarrow is missing.
    """
    try:
        import pyarrow.parquet  # noqa: F401, PLC0415 - an extra
    except ImportError:
        raise UsageError(f"Parquet files need pyarrow; {INSTALL_PYARROW}") from None


class Table:
    """A table in the Parquet files of a folder; one row group at a time is in memory."""

    def __init__(self, folder: Path) -> None:
        """Open the files, in the order of their names.

        Raises:
            UsageError: pyarrow is missing, or one is not a Parquet file.
            OSError: one cannot be read.
        """
        self._paths = sorted(folder.glob("*.parquet"))
        self._files = [open_parquet(path) for path in self._paths]
        self._groups = [
            (at, group)
            for at, file in enumerate(self._files)
            for group in range(file.num_row_groups)
        ]
        sizes = (self._files[at].metadata.row_group(n).num_rows for at, n in self._groups)
        self._starts = list(accumulate(sizes, initial=0))
        self._group: tuple[int, pa.Table] | None = None
        self._block: tuple[int, list[dict[str, Any]]] | None = None

    def has_columns(self, names: Iterable[str]) -> bool:
        """Whether all files have these columns."""
        wanted = set(names)
        return all(wanted <= set(file.schema_arrow.names) for file in self._files)

    def column(self, name: str) -> Iterator[Any]:
        """All values of a column; none if the files have no such column.

        Raises:
            UsageError: a file is damaged.
            OSError: one cannot be read.
        """
        for path, file in zip(self._paths, self._files, strict=True):
            with _as_usage_error(path):
                if name in file.schema_arrow.names:
                    for batch in file.iter_batches(columns=[name]):
                        yield from batch.column(0).to_pylist()

    def row(self, number: int) -> dict[str, Any]:
        """A row by its number in the whole table; fast if the rows are read in order.

        Raises:
            UsageError: its file is damaged.
            OSError: it cannot be read.
        """
        group = bisect_right(self._starts, number) - 1
        first = self._starts[group]
        start = number - (number - first) % _BLOCK_ROWS
        at, index = self._groups[group]
        with _as_usage_error(self._paths[at]):
            if self._group is None or self._group[0] != group:
                self._group = (group, self._files[at].read_row_group(index))
            if self._block is None or self._block[0] != start:
                self._block = (start, self._group[1].slice(start - first, _BLOCK_ROWS).to_pylist())
        row: dict[str, Any] = self._block[1][number - start]
        return row

    def close(self) -> None:
        """Close the files."""
        for file in self._files:
            file.close()


def write_table(
    folder: Path, columns: Mapping[str, object], rows: Iterable[Mapping[str, object]]
) -> None:
    """Write a table as one or more Parquet files.

    Args:
        folder: an existing folder.
        columns: type of each column by its name: ``str``, ``int`` or ``float``; a list with
            the type of its entries; a mapping of names to types.
        rows: values by the names of the columns.
    """
    import pyarrow as pa  # noqa: PLC0415 - an extra
    import pyarrow.parquet as pq  # noqa: PLC0415

    schema = pa.schema([(name, _arrow_type(kind)) for name, kind in columns.items()])
    rows = iter(rows)
    groups = iter(lambda: list(islice(rows, _GROUP_ROWS)), [])
    for number in count():
        part = list(islice(groups, 1))
        if not part and number:
            return
        path = folder / f"part-{number:05}.parquet"
        with pq.ParquetWriter(path, schema, compression="zstd") as writer:
            for group in chain(part, islice(groups, _PART_GROUPS - 1)):
                writer.write_table(pa.Table.from_pylist(group, schema))


def _arrow_type(kind: object) -> pa.DataType:
    import pyarrow as pa  # noqa: PLC0415 - an extra

    if isinstance(kind, list):
        return pa.list_(_arrow_type(kind[0]))
    if isinstance(kind, Mapping):
        return pa.struct([(name, _arrow_type(part)) for name, part in kind.items()])
    return pa.string() if kind is str else pa.int64() if kind is int else pa.float64()


def column_texts(path: Path, column: str | None) -> Iterator[str]:
    """The texts of a column, a row group at a time; empty ones are left out.

    Args:
        path: a file, or a folder of files that are read in the order of their names.
        column: its name; None for the only one, or ``path``.

    Raises:
        UsageError: pyarrow is missing, it is not a Parquet file, or has no such column of texts.
        OSError: it cannot be read.
    """
    paths = sorted(path.glob("*.parquet")) if path.is_dir() else [path]
    if not paths:
        raise UsageError(f"no .parquet file in {path}")
    for one in paths:  # before any is read
        with open_parquet(one) as file, _as_usage_error(one):
            _text_column(file, column, one)
    return (text for one in paths for text in _texts(one, column))


def open_parquet(path: Path) -> pq.ParquetFile:
    """Open a file for reading.

    Raises:
        UsageError: pyarrow is missing, or it is not a Parquet file.
        OSError: it cannot be read.
    """
    check_pyarrow()
    import pyarrow.parquet as pq  # noqa: PLC0415 - an extra

    path.open("rb").close()  # pyarrow's message about a missing file has several lines
    with _as_usage_error(path):
        return pq.ParquetFile(path)


@contextmanager
def _as_usage_error(path: Path) -> Iterator[None]:
    """Raise one kind of error for all that pyarrow raises for a damaged file."""
    import pyarrow as pa  # noqa: PLC0415 - an extra

    try:
        yield
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        if isinstance(error, OSError) and error.errno is not None:  # it is the disk
            raise
        reason = one_line(" ".join(str(error).split()))
        raise UsageError(
            f"{path} is not a complete Parquet file: {reason}; write it again, or move it away"
        ) from error


def select_column(columns: Sequence[str], column: str | None, path: Path) -> str:
    """The name of the column to read: the given one, the only one, or ``path``.

    Raises:
        UsageError: there is none.
    """
    wanted = column or (columns[0] if len(columns) == 1 else _DEFAULT_COLUMN)
    if wanted not in columns:
        there = f"its columns are {', '.join(columns)}" if columns else "it has no columns"
        raise UsageError(f"{path} has no column {wanted!r}; {there}: name one with --column")
    return wanted


def _text_column(file: pq.ParquetFile, column: str | None, path: Path) -> str:
    import pyarrow as pa  # noqa: PLC0415 - an extra

    schema = file.schema_arrow
    wanted = select_column(schema.names, column, path)
    kind = schema.field(wanted).type
    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        raise UsageError(f"column {wanted!r} of {path} holds {kind}, not texts; name another one")
    return wanted


def _texts(path: Path, column: str | None) -> Iterator[str]:
    with open_parquet(path) as file, _as_usage_error(path):
        wanted = _text_column(file, column, path)
        for batch in file.iter_batches(columns=[wanted]):
            yield from filter(None, batch.column(0).to_pylist())
