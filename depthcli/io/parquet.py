"""Lists of inputs in Parquet files; the only module that imports pyarrow."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from depthcli.core.options import INSTALL_PYARROW, one_line
from depthcli.errors import UsageError

if TYPE_CHECKING:
    from pathlib import Path

    import pyarrow.parquet as pq

_DEFAULT_COLUMN = "path"


def check_pyarrow() -> None:
    """Check that Parquet files can be read and written.

    Raises:
        UsageError: pyarrow is missing.
    """
    try:
        import pyarrow.parquet  # noqa: F401, PLC0415 - an extra
    except ImportError:
        raise UsageError(f"Parquet files need pyarrow; {INSTALL_PYARROW}") from None


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
        raise UsageError(f"{path} has no column {wanted!r}; {there}", "name one with {column}")
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
