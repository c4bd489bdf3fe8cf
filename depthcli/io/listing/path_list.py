"""Lists of inputs: one path a line, as ``find`` and ``git ls-files`` print them, or a table."""

from __future__ import annotations

import csv
import os
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.core.options import INSTALL_PYARROW, one_line
from depthcli.errors import InputError, UsageError, os_errors_as
from depthcli.io.listing.folder import InputFile
from depthcli.io.media import is_exr, is_media
from depthcli.io.storage import paths

if TYPE_CHECKING:
    import pyarrow.parquet as pq

PATHS = "path"  #: column of a table with the paths, where there are several
_MAX_PROBED = 1000
_DELIMITERS = {".csv": ",", ".tsv": "\t"}


def read_list(source: str, column: str | None = None) -> Iterator[str]:
    """The paths of a text, or of a table: ``.parquet`` (a file, or a folder of them), CSV or TSV.

    They are in the table's column, or in its only one, or in that called ``path``, read a part at a
    time. UsageError if they cannot be read.
    """
    where = paths.path_of(source)
    suffix = where.suffix.lower()
    try:
        with (
            os_errors_as(UsageError, f"cannot read the list {where}"),
            paths.local_copy(where) as path,
        ):
            if suffix == ".parquet":
                yield from column_texts(path, column)
            elif suffix in _DELIMITERS:
                yield from _csv_texts(path, column, _DELIMITERS[suffix])
            elif column is not None:
                raise UsageError(f"{where} is no list in Parquet or CSV", "leave out {column}")
            else:
                yield from parse_list(path.read_bytes())
    except InputError as error:  # of a copy
        raise UsageError(f"the list {error}") from error


def _csv_texts(path: Path, column: str | None, delimiter: str) -> Iterator[str]:
    with path.open(newline="", encoding="utf-8-sig", errors="surrogateescape") as file:
        rows = csv.reader(file, delimiter=delimiter)
        try:
            header = next(rows, [])
            # Without a first line of names, a list of one column begins with an image.
            name = os.path.basename(header[0]) if len(header) == 1 else ""  # noqa: PTH119 - any bytes
            is_list = column is None and (is_media(name) or is_exr(name))
            place = 0 if is_list else header.index(_select_column(header, column, path))
            for row in chain((header,) if is_list else (), rows):
                if len(row) > len(header):
                    problem = f"{len(row)} values for {len(header)} columns"
                    raise UsageError(f"{path}, line {rows.line_num}: {problem}")
                if len(row) > place and row[place]:
                    yield row[place]
        except csv.Error as error:
            raise UsageError(f"{path}, line {rows.line_num}: {error}") from error


def parse_list(data: bytes) -> list[str]:
    """Paths, one a line, or separated by NUL bytes (``find -print0``), in their order."""
    if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):  # as Windows PowerShell 5.1 redirects
        raise UsageError("the list is in UTF-16", "write it in UTF-8")
    data = data.removeprefix(BOM_UTF8)
    words = data.split(b"\0") if b"\0" in data else data.splitlines()
    return [os.fsdecode(word) for word in words if word]


def listed_inputs(words: Iterable[str], root: str | None) -> Iterator[InputFile]:
    """Listed paths, with their names relative to ``root``; a name can come more than once.

    They are absolute, or from ``root``; or from the working directory, as ``find root`` prints
    them, if more of the first thousand exist there. One outside ``root``, or an absolute one
    without it, is named by all its folders.
    """
    words = map(_local_path, words)
    first = list(islice(words, _MAX_PROBED))
    base = os.path.abspath(root or ".")  # noqa: PTH100 - links stay as named
    starts = (root or "",) if paths.is_remote(root or "") else (root or "", "")
    start = max(
        starts,
        key=lambda folder: sum(os.path.lexists(os.path.join(folder, word)) for word in first),  # noqa: PTH118
    )
    for word in chain(first, words):
        path = paths.join(start, word)
        is_whole = root is None and os.path.isabs(path)  # noqa: PTH117 - may be a URI
        place = os.path.abspath(path)  # noqa: PTH100 - links stay as named
        name = _whole_name(place) if is_whole else _relative_name(place, base)
        yield _listed_uri(path, root or ".") or InputFile(name, path)


def _local_path(word: str) -> str:
    """A ``file://`` URI as a path."""
    try:
        return paths.without_file_scheme(word)
    except UsageError:
        return word  # the problem is reported with this input


def _listed_uri(uri: str, root: str) -> InputFile | None:
    """A remote input; None if the path is local."""
    if "://" not in uri:
        return None
    try:
        path = paths.path_of(uri)
        if not isinstance(path, paths.RemotePath):
            return None
        folder = paths.path_of(root)
        if isinstance(folder, paths.RemotePath) and path.is_relative_to(folder):
            return InputFile(path.relative_to(folder).as_posix(), uri)
        return InputFile(str(path).partition("://")[2], uri)
    except UsageError as error:
        return InputFile(uri.replace("://", "/"), uri, str(error))


def _relative_name(path: str, base: str) -> str:
    inside = path.startswith(base.rstrip(os.sep) + os.sep)
    tail = path[len(base.rstrip(os.sep)) :]
    return tail.lstrip(os.sep).replace(os.sep, "/") if inside else _whole_name(path)


def _whole_name(path: str) -> str:
    return os.path.splitdrive(path)[1].lstrip(os.sep).replace(os.sep, "/")


@contextmanager
def open_parquet(path: Path) -> Iterator[pq.ParquetFile]:
    """An open file; what pyarrow raises for a damaged one becomes one kind of error."""
    try:
        import pyarrow as pa  # noqa: PLC0415 - an extra
        import pyarrow.parquet as pq  # noqa: PLC0415
    except ImportError:
        raise UsageError(f"Parquet files need pyarrow; {INSTALL_PYARROW}") from None
    path.open("rb").close()  # pyarrow's message about a missing file has several lines
    try:
        with pq.ParquetFile(path) as file:
            yield file
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        if isinstance(error, OSError) and error.errno is not None:  # it is the disk
            raise
        reason = one_line(" ".join(str(error).split()))
        raise UsageError(f"{path} is not a complete Parquet file: {reason}") from error


def _select_column(columns: Sequence[str], column: str | None, path: Path) -> str:
    """The name of the column to read: the given one, the only one, or ``path``."""
    name = column or (columns[0] if len(columns) == 1 else PATHS)
    if name not in columns:
        there = f"its columns are {', '.join(columns)}" if columns else "it has no columns"
        raise UsageError(f"{path} has no column {name!r}; {there}", "name one with {column}")
    return name


def _text_column(file: pq.ParquetFile, column: str | None, path: Path) -> str:
    import pyarrow as pa  # noqa: PLC0415 - an extra

    schema = file.schema_arrow
    name = _select_column(schema.names, column, path)
    kind = schema.field(name).type
    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        raise UsageError(f"column {name!r} of {path} holds {kind}, not texts; name another one")
    return name


def column_texts(path: Path, column: str | None) -> Iterator[str]:
    """The texts of a column of a file or of a folder of files, a row group at a time."""
    parts = sorted(path.glob("*.parquet")) if path.is_dir() else [path]
    if not parts:
        raise UsageError(f"no .parquet file in {path}")
    for part in parts:  # before any is read
        with open_parquet(part) as file:
            _text_column(file, column, part)
    for part in parts:
        with open_parquet(part) as file:
            for batch in file.iter_batches(columns=[_text_column(file, column, part)]):
                yield from filter(None, batch.column(0).to_pylist())
