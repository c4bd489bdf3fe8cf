"""Lists of inputs: one path a line, as ``find`` and ``git ls-files`` print them, or a table."""

import csv
import os
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Callable, Iterable, Iterator
from io import TextIOWrapper
from itertools import chain, islice
from pathlib import Path

from depthcli.errors import InputError, UsageError
from depthcli.io.listing.folder import InputFile, Skipped, why_skipped
from depthcli.io.parquet import column_texts, select_column
from depthcli.io.storage.paths import RemotePath, is_remote, join, path_of, without_file_scheme
from depthcli.io.storage.transfer import local_copy

_MAX_PROBED = 1000
_DELIMITERS = {".csv": ",", ".tsv": "\t"}


def read_list(source: str, column: str | None = None) -> Iterable[str]:
    """The paths of a list, in its order; of tables a part at a time.

    Args:
        source: a file of text, or a table by its suffix: ``.parquet`` (a file, or a folder of
            them), ``.csv`` or ``.tsv`` with the names of the columns in the first line.
        column: of a table, the one with the paths; None for the only one, or ``path``.

    Raises:
        UsageError: the list cannot be read, or has no such column.
    """
    if is_remote(source):
        return _remote_list(source, column)
    path, suffix = Path(source), Path(source).suffix.lower()
    try:
        if suffix == ".parquet":
            return column_texts(path, column)
        if suffix in _DELIMITERS:
            return _csv_texts(path, column, _DELIMITERS[suffix])
        if column is not None:
            raise UsageError(f"{source} is no list in Parquet or CSV", "leave out {column}")
        return parse_list(path.read_bytes())
    except OSError as error:
        raise UsageError(f"cannot read the list {source}: {error.strerror or error}") from error


def _remote_list(source: str, column: str | None) -> Iterator[str]:
    try:
        with local_copy(path_of(source)) as copy:
            yield from read_list(str(copy), column)
    except InputError as error:
        raise UsageError(f"the list {error}") from error


def _csv_texts(path: Path, column: str | None, delimiter: str) -> Iterator[str]:
    data = path.open("rb")  # once: it may be a pipe
    _check_encoding(data.peek(len(BOM_UTF8)))
    file = TextIOWrapper(data, newline="", encoding="utf-8-sig", errors="surrogateescape")
    rows = csv.reader(file, delimiter=delimiter)
    header = next(rows, [])
    place = header.index(select_column(header, column, path))

    def texts() -> Iterator[str]:
        with file:
            try:
                yield from (row[place] for row in rows if len(row) > place and row[place])
            except csv.Error as error:
                raise UsageError(f"{path}, line {rows.line_num}: {error}") from error

    return texts()


def parse_list(data: bytes) -> list[str]:
    """Paths of a list, in its order.

    One a line, or separated by NUL bytes (``find -print0``), which allows newlines in names.

    Raises:
        UsageError: it is in UTF-16, as some shells of Windows write it.
    """
    _check_encoding(data)
    data = data.removeprefix(BOM_UTF8)
    words = data.split(b"\0") if b"\0" in data else data.splitlines()
    return [os.fsdecode(word) for word in words if word]


def _check_encoding(data: bytes) -> None:
    if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        raise UsageError("the list of inputs is in UTF-16; save it in UTF-8")


def listed_inputs(words: Iterable[str], root: str | None) -> Iterator[InputFile]:
    """Listed paths, with their names relative to a folder; a name can come more than once.

    Args:
        words: absolute paths, or paths from ``root``; or from the working directory, as ``find
            root`` prints them, if more of the first thousand exist there.
        root: the folder whose tree is kept; if it is in a store, paths are always relative to it. A
            path outside it is named by all its folders. None for the working directory and relative
            paths; absolute ones are then named by all their folders, so that names do not depend on
            it.
    """
    words = map(_local_path, words)
    first = list(islice(words, _MAX_PROBED))
    base = os.path.abspath(root or ".")  # noqa: PTH100 - links stay as named
    starts = (root or "",) if is_remote(root or "") else (root or "", "")
    start = max(starts, key=lambda folder: _existing(first, folder))
    for word in chain(first, words):
        path = join(start, word)
        is_whole = root is None and os.path.isabs(path)  # noqa: PTH117 - may be a URI
        place = os.path.abspath(path)  # noqa: PTH100 - links stay as named
        name = _whole_name(place) if is_whole else _relative_name(place, base)
        yield _listed_uri(path, root or ".") or InputFile(name, path)


def _local_path(word: str) -> str:
    """A ``file://`` URI as a path."""
    try:
        return without_file_scheme(word)
    except UsageError:
        return word  # the problem is reported with this input


def _listed_uri(uri: str, root: str) -> InputFile | None:
    """A remote input; None if the path is local."""
    if "://" not in uri:
        return None
    try:
        path = path_of(uri)
        if not isinstance(path, RemotePath):
            return None
        folder = path_of(root)
        if isinstance(folder, RemotePath) and path.is_relative_to(folder):
            return InputFile(path.relative_to(folder).as_posix(), uri)
        return InputFile(str(path).partition("://")[2], uri)
    except UsageError as error:
        return InputFile(uri.replace("://", "/"), uri, str(error))


def _existing(words: Iterable[str], folder: str) -> int:
    return sum(os.path.lexists(os.path.join(folder, word)) for word in words)  # noqa: PTH118


def _relative_name(path: str, base: str) -> str:
    inside = path.startswith(base.rstrip(os.sep) + os.sep)
    tail = path[len(base.rstrip(os.sep)) :]
    return tail.lstrip(os.sep).replace(os.sep, "/") if inside else _whole_name(path)


def _whole_name(path: str) -> str:
    return os.path.splitdrive(path)[1].lstrip(os.sep).replace(os.sep, "/")


def list_objects(
    root: RemotePath,
    leave_out: Path,
    skip: Callable[[str], bool],
    on_skipped: Callable[[Skipped], None],
    refusal: Callable[[str], str | None] = why_skipped,
) -> Iterator[InputFile]:
    """Pictures and videos, in the order of the store, page by page; arguments as of a local folder.

    Raises:
        UsageError: the store cannot be listed, or there is nothing below it.
    """
    out = f"{leave_out.relative_to(root)}/" if leave_out.is_relative_to(root) else None
    start, folder, is_entered = f"{root.base}/{root.key}".rstrip("/"), None, True
    try:
        for name in root.walk_names():
            above = name.rpartition("/")[0]
            if above != folder:  # names come folder by folder
                folder, is_entered = above, not _is_skipped(above, skip)
            # Some tools create an empty object for the folder itself.
            if not name or not is_entered or (out and name.startswith(out)):
                continue
            path = f"{start}/{name}"
            reason = refusal(path)
            if reason is None:
                yield InputFile(name, path)
            else:
                on_skipped(Skipped(name, reason))
    except OSError as error:
        raise UsageError(f"{root} cannot be listed: {error.strerror}") from error
    if folder is None:
        raise UsageError(f"{root} is not a folder", "name one, or give {files} a list")


def walk_sort_key(name: str) -> list[tuple[bool, bytes]]:
    """Key that sorts names in the order of a walk of folders: files before folders."""
    *above, last = name.encode("utf-8", "surrogateescape").split(b"/")
    return [*((True, part) for part in above), (False, last)]


def _is_skipped(folder: str, skip: Callable[[str], bool]) -> bool:
    parts = folder.split("/") if folder else []
    return any(
        part.startswith(".") or skip("/".join(parts[: depth + 1]))
        for depth, part in enumerate(parts)
    )
