"""The images and videos below a folder, patterns for their names, and lists of inputs.

A list has one path a line, as ``find`` and ``git ls-files`` print them, or is a table. Errors of
tables name line and column.
"""

import csv
import math
import os
import re
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial
from io import StringIO
from itertools import chain, islice
from pathlib import Path
from typing import Any, NamedTuple, Self

from depthcli.core.options import INSTALL_PYARROW, Rule, one_line, short_repr
from depthcli.errors import InputError, UsageError, os_errors_as
from depthcli.io.guard import is_own_output
from depthcli.io.media import CAMERA_RAW, EXTRAS, is_exr, is_media, lower_suffix
from depthcli.io.storage import atomic, objects, paths

HIDDEN = "hidden"
SYSTEM_FOLDERS = frozenset(
    ("@eaDir", "#recycle", "#snapshot", "$RECYCLE.BIN", "System Volume Information", "__MACOSX")
)
"""Folders of Synology's, QNAP's and Windows' systems, and of macOS in archives: no user's files."""
OWN = "written by depthcli"
EXCLUDED = "excluded"
NOT_INCLUDED = "not included"
TWICE = "listed twice"
_MAX_REASONS = 6


class Skipped(NamedTuple):
    """A file that is not an input."""

    name: str  #: path relative to the folder, with ``/`` between its parts
    reason: str  #: one of the words above, the file's suffix, or the name of a system's folder


def skip_summary(skipped: Sequence[Skipped]) -> str:
    """Number of skipped files and reasons: ``3 files skipped (2 .txt, 1 hidden)``."""
    counts = Counter(file.reason for file in skipped).most_common()
    reasons = [f"{count} {reason}" for reason, count in counts[:_MAX_REASONS]]
    if len(counts) > _MAX_REASONS:
        reasons.append(f"{sum(count for _, count in counts[_MAX_REASONS:])} others")
    files = "file" if len(skipped) == 1 else "files"
    return f"{len(skipped)} {files} skipped ({', '.join(reasons)})"


def conversion_hint(skipped: Sequence[Skipped]) -> str | None:
    """Advice about images of formats that are not read in a folder; None if there are none."""
    counts = Counter(file.reason for file in skipped)
    unread = sorted(suffix for suffix in counts if suffix in (*EXTRAS, *CAMERA_RAW))
    if not unread:
        return None
    installs = sorted({EXTRAS[suffix][1] for suffix in unread if suffix in EXTRAS})
    return (
        f"{sum(counts[suffix] for suffix in unread)} skipped of formats that are not read "
        f"({', '.join(unread)}); {', or '.join(('convert to JPEG, PNG or TIFF', *installs))}"
    )


class InputFile(NamedTuple):
    """A file below a folder, or a folder that cannot be read."""

    name: str  #: path relative to the folder, with ``/`` between its parts
    path: str  #: its full path or URI
    problem: str | None = None  #: why it cannot be read, if that is known already

    def readable_path(self) -> Path:
        """Its local or remote path."""
        if self.problem is not None:
            raise InputError(self.problem)
        return paths.path_of(self.path)


class Listing(NamedTuple):
    """The content of a folder and its subfolders."""

    #: inputs, by default images and videos, and unreadable folders, in an order that depends on
    #: names alone
    media: list[InputFile]
    #: other files: by default neither image nor video by their suffix, hidden, or outputs
    skipped: list[Skipped]
    loops: list[str]  #: folders left out because they lead back to a folder that they are in

    def add(self, name: str, path: str, reason: str | None) -> None:
        """Add a file, which is skipped for a reason."""
        if reason is None:
            self.media.append(InputFile(name, path))
        else:
            self.skipped.append(Skipped(name, reason))


def why_skipped(path: str) -> str | None:
    """Why a file in a folder is not an input; None if it is one."""
    name = os.path.basename(path)  # noqa: PTH119 - names, not paths
    if name.startswith("."):
        return HIDDEN
    if not is_media(name):
        return lower_suffix(name) or "without suffix"
    return OWN if is_own_output(path) else None


def list_folder(
    root: str,
    *,
    leave_out: str | None = None,
    skip: Callable[[str], bool] = lambda _: False,
    refusal: Callable[[str], str | None] = why_skipped,
) -> Listing:
    """Walk a tree, depth first; links to folders are followed, loops are not.

    Only files that depthcli may have written are opened, for their first bytes.

    Args:
        root: the folder, which may be in a store.
        leave_out: a folder that is not entered, under any of its names; it may be missing.
        skip: whether a folder of this name (from the root, with ``/``) is not entered.
        refusal: why a file of this path is no input; None if it is one.
    """
    place = paths.path_of(root)
    if isinstance(place, paths.RemotePath):
        return _list_objects(place, paths.path_of(leave_out or ""), skip, refusal)
    avoided = leave_out and atomic.identity_of(leave_out)
    listing = Listing([], [], [])
    above: dict[str, tuple[atomic.FileIdentity, ...]] = {
        root: (atomic.identity_of(root),)
    }  # of those to enter
    named = partial(_relative_name, base=root)

    def not_listed(error: OSError) -> None:
        problem = f"{error.filename} cannot be listed: {error.strerror}"
        name = "." if error.filename == root else named(error.filename)
        listing.media.append(InputFile(name, error.filename, problem))

    for folder, folders, files in os.walk(root, onerror=not_listed, followlinks=True):
        inside, outer = partial(os.path.join, folder), above.pop(folder)
        for path in map(inside, sorted(files, key=os.fsencode)):
            listing.add(named(path), path, refusal(path))
        children, folders[:] = sorted(folders, key=os.fsencode), ()
        for child in children:
            path = inside(child)
            if child.startswith(".") or skip(named(path)):
                continue
            identity = atomic.identity_of(path)
            if child in SYSTEM_FOLDERS:
                listing.skipped.append(Skipped(named(path), child))
            elif identity in outer:
                listing.loops.append(named(path))
            elif identity != avoided:
                folders.append(child)
                above[path] = (*outer, identity)
    return listing


def _list_objects(
    root: paths.RemotePath,
    leave_out: Path,
    skip: Callable[[str], bool],
    refusal: Callable[[str], str | None],
) -> Listing:
    """Walk the objects of a store, in the order of a local folder."""
    out = f"{leave_out.relative_to(root)}/" if leave_out.is_relative_to(root) else None
    start, folder, is_entered = f"{root.base}/{root.key}".rstrip("/"), None, True
    listing = Listing([], [], [])
    with os_errors_as(UsageError, f"{root} cannot be listed"):
        for name in root.walk_names():
            above = name.rpartition("/")[0]
            if above != folder:  # names come folder by folder
                folder, is_entered = above, not _is_skipped(above, skip)
            # Some tools create an empty object for the folder itself.
            if not name or name.endswith("/") or not is_entered or (out and name.startswith(out)):
                continue
            place = f"{start}/{name}"
            if {"", ".", ".."}.isdisjoint(name.split("/")):
                listing.add(name, place, refusal(place))
            else:
                listing.media.append(InputFile(name, place, f"{place}: {objects.NO_PATH}"))
    if folder is None:
        raise UsageError(f"{root} is not a folder", "name one, or give {files} a list")
    listing.media.sort(key=lambda file: _walk_sort_key(file.name))
    return listing


def _walk_sort_key(name: str) -> list[tuple[bool, bytes]]:
    """Key that sorts names in the order of a walk of folders: files before folders."""
    *above, last = name.encode("utf-8", "surrogateescape").split(b"/")
    return [*((True, part) for part in above), (False, last)]


def _is_skipped(folder: str, skip: Callable[[str], bool]) -> bool:
    parts = folder.split("/") if folder else []
    return any(
        part.startswith(".") or part in SYSTEM_FOLDERS or skip("/".join(parts[: depth + 1]))
        for depth, part in enumerate(parts)
    )


class RealPaths:
    """Resolves links, with a cache of folders; short-lived, as folders and links change."""

    def __init__(self) -> None:
        self._real_folder = cache(os.path.realpath)

    def of(self, path: str | Path) -> str:
        """The path with links in its folder resolved; if the file is a link, that is kept."""
        folder, name = os.path.split(path)
        return os.path.join(self._real_folder(folder), name)  # noqa: PTH118

    def all_of(self, path: str | Path) -> set[str]:
        """Names of the file, and of the target if it is a link."""
        place = self.of(path)
        return {place, os.path.realpath(place)} if os.path.islink(place) else {place}  # noqa: PTH114


_WILDCARDS = {"**/": "(?:.*/)?", "**": ".*", "*": "[^/]*", "?": "[^/]"}
_TOKEN = re.compile(r"\*\*/|\*\*|\*|\?|\[!?\]?[^\]/]*\]|.", re.DOTALL)


class NameFilter(NamedTuple):
    """Patterns for paths relative to a root, with ``/`` between their parts.

    A pattern without ``/`` is matched with the last part, in any folder; one with ``/`` with the
    whole path. ``*`` and ``?`` do not match ``/``, ``**`` does.
    """

    include: tuple[re.Pattern[str], ...]  #: a file has to match one of these, if there are any
    exclude: tuple[re.Pattern[str], ...]  #: a file or a folder must match none of these

    @classmethod
    def of(cls, include: Sequence[str], exclude: Sequence[str]) -> Self:
        """From patterns as the user gives them."""
        return cls(tuple(map(_compiled, include)), tuple(map(_compiled, exclude)))

    def refusal(self, name: str) -> str | None:
        """Why a file is not wanted, by its own name and its folders'; None if it is wanted."""
        parts = name.split("/")
        if self.exclude and any(
            self.excludes("/".join(parts[: at + 1])) for at in range(len(parts))
        ):
            return EXCLUDED
        is_included = not self.include or any(p.fullmatch(name) for p in self.include)
        return None if is_included else NOT_INCLUDED

    def excludes(self, name: str) -> bool:
        """Whether a file or folder is excluded by its own name."""
        return any(pattern.fullmatch(name) for pattern in self.exclude)


ANY = NameFilter((), ())  #: every name


def _compiled(pattern: str) -> re.Pattern[str]:
    trimmed = pattern.rstrip("/")
    anywhere = "" if "/" in trimmed else "(?:.*/)?"
    tokens = _TOKEN.findall(trimmed.removeprefix("/").removeprefix("./"))
    try:
        return re.compile(anywhere + "".join(map(_expression, tokens)), re.DOTALL)
    except re.error as error:
        raise UsageError(f"{pattern!r} is not a valid pattern: {error.msg}") from error


def _expression(token: str) -> str:
    if token in _WILDCARDS:
        return _WILDCARDS[token]
    if len(token) > 1:  # a class of characters, [a-z] or [!a-z]
        inner = token[1:-1].replace("\\", "\\\\").replace("[", "\\[")
        return f"[^{inner[1:]}/]" if inner.startswith("!") else f"[{inner}]"
    return re.escape(token)


PATHS = "path"  #: column of a table with the paths, where there are several
_MAX_PROBED = 1000
_DELIMITERS = {".csv": ",", ".tsv": "\t"}


def read_list(source: str, column: str | None = None) -> Iterator[str]:
    """The paths of a text, or of a table: ``.parquet`` (a file, or a folder of them), CSV or TSV.

    They are in the table's column, or in its only one, or in that called ``path``; Parquet is read
    a part at a time. UsageError if they cannot be read.
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
                yield from _csv_texts(path, column)
            elif column is not None:
                raise UsageError(f"{where} is no list in Parquet or CSV", "leave out {column}")
            else:
                yield from parse_list(path.read_bytes())
    except InputError as error:  # of a copy, or of CSV
        raise UsageError(f"the list {error}") from error


def _csv_texts(path: Path, column: str | None) -> Iterator[str]:
    table = CsvTable(path.read_bytes(), str(path), _DELIMITERS[path.suffix.lower()])
    # Without a first line of names, a list of one column begins with an image.
    first = table.columns[0] if len(table.columns) == 1 else ""
    name = os.path.basename(first)  # noqa: PTH119 - names with any byte pass here
    if is_list := column is None and (is_media(name) or is_exr(name)):
        yield first
    place = first if is_list else _select_column(table.columns, column, path)
    yield from filter(None, (row.cells[place] for row in table))


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
    words = map(paths.without_file_scheme, words)
    first = list(islice(words, _MAX_PROBED))
    base = os.path.abspath(root or ".")  # noqa: PTH100 - links stay as named
    is_remote = isinstance(paths.path_of(root or ""), paths.RemotePath)
    starts = (root or "",) if is_remote else (root or "", "")
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
def open_parquet(path: Path) -> Iterator[Any]:
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


def column_texts(path: Path, column: str | None) -> Iterator[str]:
    """The texts of a column of a file or of a folder of files, a row group at a time."""
    parts = sorted(path.glob("*.parquet")) if path.is_dir() else [path]
    if not parts:
        raise UsageError(f"no .parquet file in {path}")
    for part in parts:
        with open_parquet(part) as file:
            name = _select_column(file.schema_arrow.names, column, part)
            for batch in file.iter_batches(columns=[name]):
                yield from filter(None, batch.column(0).cast("string").to_pylist())


class CsvRow(NamedTuple):
    """A row of a table."""

    name: str  #: the table, for messages
    line: int  #: its last line, from 1
    cells: Mapping[str, str]  #: by column; "" where the row is too short

    def number(self, column: str, rule: Rule) -> float:
        """The number in a cell; NaN if it is empty."""
        word = self.cells[column]
        try:
            number = float(word or math.nan)
        except ValueError:
            number = None
        if number is None or not rule.holds(number):
            raise self.error(f"{column} is {rule.what}, not {short_repr(word)}")
        return number

    def error(self, problem: str) -> InputError:
        """The error to raise for a problem of this row."""
        return InputError(f"{self.name}, line {self.line}: {problem}")


class CsvTable:
    """A table in UTF-8; other bytes become surrogates, as in the names of files.

    Attributes:
        name: its own, for messages.
        columns: names of its columns, without spaces around them; none if it is empty.
    """

    def __init__(self, data: bytes, name: str, delimiter: str = ",") -> None:
        text = StringIO(data.decode("utf-8-sig", "surrogateescape"), newline="")
        self._lines = csv.reader(text, delimiter=delimiter, strict=True, skipinitialspace=True)
        self.name = name
        self.columns = [word.strip() for word in next(self._cells(), [])]

    def __iter__(self) -> Iterator[CsvRow]:
        """The rows after the first line that are not empty, once."""
        empty = dict.fromkeys(self.columns, "")
        for cells in filter(None, self._cells()):
            if len(cells) > len(self.columns):
                raise self._error(f"{len(cells)} values for {len(self.columns)} columns")
            named = dict(zip(self.columns, map(str.strip, cells), strict=False))
            yield CsvRow(self.name, self._lines.line_num, empty | named)

    def _cells(self) -> Iterator[list[str]]:
        try:
            yield from self._lines
        except csv.Error as error:
            raise self._error(str(error)) from error

    def _error(self, problem: str) -> InputError:
        return InputError(f"{self.name}, line {self._lines.line_num}: {problem}")
