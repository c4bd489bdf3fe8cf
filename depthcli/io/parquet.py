"""Tables in Parquet files; the only module that imports pyarrow."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    import pyarrow.parquet as pq

INSTALL_PYARROW = "pip install pyarrow"
_USUAL = "path"


def column_texts(path: Path, column: str | None) -> Iterator[str]:
    """The texts of a column, a row group at a time; empty ones are left out.

    Args:
        path: a file, or a folder of them that are read in the order of their names.
        column: its name; None for the only one, or ``path``.

    Raises:
        UsageError: pyarrow is missing, it is no Parquet file, or it has no such column of texts.
        OSError: it cannot be read.
    """
    paths = sorted(path.glob("*.parquet")) if path.is_dir() else [path]
    if not paths:
        raise UsageError(f"no .parquet file in {path}")
    for one in paths:  # before any is read
        with open_parquet(one) as file:
            _text_column(file, column, one)
    return (text for one in paths for text in _texts(one, column))


def open_parquet(path: Path) -> pq.ParquetFile:
    """A file that is open for reading.

    Raises:
        UsageError: pyarrow is missing, or it is no Parquet file.
        OSError: it cannot be read.
    """
    try:
        import pyarrow as pa  # noqa: PLC0415 - an extra
        import pyarrow.parquet as pq  # noqa: PLC0415
    except ImportError:
        raise UsageError(f"Parquet files need pyarrow; {INSTALL_PYARROW}") from None
    path.open("rb").close()  # pyarrow's own words for what is missing are of several lines
    try:
        return pq.ParquetFile(path)
    except pa.ArrowInvalid as error:
        raise UsageError(f"{path} is no whole Parquet file: {error}") from error


def only_column(columns: Sequence[str], column: str | None, path: Path) -> str:
    """The column that is meant: the one named, the only one, or ``path``.

    Raises:
        UsageError: there is none.
    """
    wanted = column or (columns[0] if len(columns) == 1 else _USUAL)
    if wanted not in columns:
        there = f"its columns are {', '.join(columns)}" if columns else "it has no columns"
        raise UsageError(f"{path} has no column {wanted!r}; {there}: name one with --column")
    return wanted


def _text_column(file: pq.ParquetFile, column: str | None, path: Path) -> str:
    import pyarrow as pa  # noqa: PLC0415 - an extra

    schema = file.schema_arrow
    wanted = only_column(schema.names, column, path)
    kind = schema.field(wanted).type
    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        raise UsageError(f"column {wanted!r} of {path} holds {kind}, not texts; name another one")
    return wanted


def _texts(path: Path, column: str | None) -> Iterator[str]:
    with open_parquet(path) as file:
        wanted = _text_column(file, column, path)
        for batch in file.iter_batches(columns=[wanted]):
            yield from filter(None, batch.column(0).to_pylist())
