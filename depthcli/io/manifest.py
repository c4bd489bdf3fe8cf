"""Rows of a batch's inputs: the manifest, and the journal from which a killed batch is resumed.

Rows are appended line by line to the journal, a hidden file, not kept in memory. When the batch
ends without being killed, they are written to the manifest atomically.
"""

import hashlib
import json
import os
import re
import shutil
import sqlite3
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Self

from depthcli.core.options import AnchorsFit, Rule
from depthcli.core.validation import FieldError, parsed_json, validated
from depthcli.errors import OutputError, UsageError, os_errors_as
from depthcli.io.storage.atomic import append_whole, atomic_path
from depthcli.io.storage.objects import fetch
from depthcli.io.storage.paths import RemotePath, object_checksum, regular_size
from depthcli.io.storage.temporary import folder_lock, open_locked, temporary_folder

OK = "ok"
FAILED = "failed"
_SECONDS = Rule("a number from 0 to 1e9", lambda number: 0 <= number <= 1e9)  # noqa: PLR2004


@dataclass(frozen=True, slots=True)
class OutputFile:
    """One file that was written."""

    path: str  #: relative to the output folder, with ``/`` between its parts
    bytes: int  #: its size
    sha256: str  #: its checksum, 64 hex digits


@dataclass(frozen=True, slots=True)
class CacheKey:
    """Options and model of a whole batch, which its outputs depend on besides their inputs."""

    options_sha256: str  #: checksum of the options that the outputs depend on
    model: str  #: name of the model
    model_sha256: str  #: checksum of its file
    version: str  #: of depthcli


@dataclass(frozen=True, slots=True)
class AnchorEntry:
    """The known points that the depth of an input was fitted to."""

    given: int  #: all points
    used: int  #: those that depth was fitted to; the others contradict them
    residual_m: float  #: median absolute difference of all points, in metres
    sha256: str  #: checksum of the points, 64 hex digits
    fit: AnchorsFit | None = None  #: how depth follows them; None if that is not known
    model: str | None = None  #: that made the depth, if it is not the key's


@dataclass(frozen=True, slots=True)
class ManifestRow:
    """The result of one input."""

    input: str  #: its name, with ``/`` between its parts
    status: str  #: ``ok`` or ``failed``
    key: CacheKey  #: model and options
    outputs: tuple[OutputFile, ...] = ()  #: what was written
    seconds: Annotated[float, _SECONDS] = 0.0  #: from opening the input to the last output
    input_sha256: str | None = None  #: checksum of the input; None if it could not be read
    error: str | None = None  #: why it failed; None if it did not
    warnings: tuple[str, ...] = ()  #: one-line texts
    #: the camera that its metres are for, and how it is known; None without metres
    camera: str | None = None
    anchors: AnchorEntry | None = None  #: the known points it was fitted to; None if it was not
    #: full path of the input, or its URI without password and signature; None in older manifests
    input_path: str | None = None

    def as_json(self) -> dict[str, object]:
        """The fields of one line."""
        # Not dataclasses.asdict, which copies so deeply that it takes as long as a checksum.
        return {
            "input": self.input,
            "status": self.status,
            "outputs": [_fields(file) for file in self.outputs],
            "seconds": round(self.seconds, 6),
            "input_sha256": self.input_sha256,
            "input_path": self.input_path,
            "error": self.error,
            "warnings": self.warnings,
            "camera": self.camera,
            "anchors": self.anchors and _fields(self.anchors),
            **_fields(self.key),
        }

    def as_line(self) -> bytes:
        """One line; names with bytes that are not UTF-8 are escaped as Python does."""
        return json.dumps(self.as_json(), ensure_ascii=True).encode() + b"\n"


def _fields(entry: AnchorEntry | CacheKey | OutputFile) -> dict[str, object]:
    return {name: getattr(entry, name) for name in entry.__slots__}


def parse_row(line: bytes) -> ManifestRow | None:
    """A row from its line; None if it is incomplete or not a row."""
    try:
        fields: Any = parsed_json(line)
        key = {name: fields.pop(name) for name in CacheKey.__slots__}
        return validated(ManifestRow, {**fields, "key": key})
    except (FieldError, TypeError, KeyError, AttributeError):
        return None


def checksum(path: Path) -> OutputFile | None:
    """Size and checksum of a file on disk, with its path; None if there is none."""
    try:
        if isinstance(path, RemotePath):
            found = object_checksum(path)
            return found and OutputFile(str(path), *found)
        size = regular_size(path)
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        return OutputFile(os.fspath(path), size, digest)
    except OSError as error:
        if isinstance(path, RemotePath):
            raise OutputError(f"{path} cannot be checked: {error.strerror}") from error
        return None


def is_intact(folder: Path, file: OutputFile) -> bool:
    """Whether a file is unchanged since it was written."""
    path = folder / file.path
    found = checksum(path)
    return found is not None and (found.bytes, found.sha256) == (file.bytes, file.sha256)


def output_entry(folder: Path, path: Path) -> OutputFile:
    """The entry of a file just written."""
    found = checksum(path)
    if found is None:
        raise OutputError(f"{path} is gone, or cannot be read, after it was written")
    return OutputFile(path.relative_to(folder).as_posix(), found.bytes, found.sha256)


_NAME = re.compile(r"(?:(\.depthcli-batch)|manifest)(-\d+-of-(\d+))?\.jsonl")
_PREFIXES = (".depthcli-batch", "manifest")
_UPLOAD_INTERVAL_S = 5.0
_PART = re.compile(r"\.\d{20}-[0-9a-f]{8}$")


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
        """From ``2/4``."""
        numbers = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", word)
        shard = cls(*map(int, numbers.groups())) if numbers else cls(0, 0)
        if not 1 <= shard.number <= shard.count:
            raise UsageError(f"{word} is not I/N with I from 1 to N, such as 2/4", option="shard")
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

    @property
    def journal_name(self) -> str:
        """Name of the file with the rows of a running batch."""
        return f".depthcli-batch{self.tag}.jsonl"

    @property
    def manifest_name(self) -> str:
        """Name of the file with the rows of a finished batch."""
        return f"manifest{self.tag}.jsonl"

    def owns(self, path: Path) -> bool:
        """Whether all rows of a file are of this part's inputs."""
        found = _NAME.fullmatch(path.name)
        return found is not None and (self.count == 1 or found[2] == self.tag)


WHOLE = Shard()


def is_journal(path: Path) -> bool:
    """Whether a file is the journal of a batch or of a part of one."""
    return path.name.startswith(_PREFIXES[0])


def row_files(folder: Path, shard: Shard) -> list[Path]:
    """The files that can hold rows of a shard's inputs, not of its sisters; the latest last."""
    found = []
    for path in (*folder.glob("manifest*"), *folder.glob(".depthcli-batch*")):
        match = _NAME.fullmatch(path.name)
        is_others = match and match[3] == str(shard.count) and match[2] != shard.tag
        if match and not is_others and path.exists():
            found.append(path)
    return sorted(found, key=lambda path: (path.stat().st_mtime_ns, path.name))


def damaged_lines(path: Path) -> list[int]:
    """Numbers of the lines of a file that are no rows, from 1."""
    with path.open("rb") as file:
        return [number for number, line in enumerate(file, 1) if parse_row(line) is None]


def _rows_in(file: BinaryIO) -> Iterator[tuple[str, int]]:
    """Input and position of each row of an open file, in their order; no other lines."""
    position = file.seek(0)
    for line in file:
        row = parse_row(line)
        if row is not None:
            yield row.input, position
        position += len(line)


class RowsFolder:
    """The local folder of a batch's rows: the output folder, or a temporary copy of a remote one.

    Objects cannot be appended to, so new rows of the journal are uploaded every few seconds as
    separate objects; the next batch, on any machine, finds all but the last rows of a killed one.
    """

    def __init__(self, out: Path) -> None:
        self.path = out
        self._lock, self._uploaded_s = threading.Lock(), time.monotonic()
        self._exit_stack = ExitStack()
        self._objects: dict[str, list[str]] = {}  # of each file here
        self._out = out if isinstance(out, RemotePath) else None
        if self._out is None:
            return
        self.path = self._exit_stack.enter_context(temporary_folder())
        with os_errors_as(OutputError, f"cannot use {out}"):
            for name in _row_objects(self._out):
                self._download(self._out / name)
        self._uploaded = {name: (self.path / name).stat().st_size for name in self._objects}

    def sync(self) -> None:
        """Upload the journal's new rows, if the last upload was long enough ago."""
        with self._lock:
            if self._out and time.monotonic() - self._uploaded_s >= _UPLOAD_INTERVAL_S:
                self._upload_rows(self._out)

    def finish(self, manifest: Path) -> None:
        """Upload the manifest, and delete the objects of the files that are in it and gone."""
        if self._out is None:
            return
        with self._lock:
            with atomic_path(self._out / manifest.name) as temporary:
                shutil.copyfile(manifest, temporary)
            for name, objects in self._objects.items():
                for one in () if (self.path / name).exists() else objects:
                    with os_errors_as(OutputError, f"cannot remove {one}"):
                        (self._out / one).unlink()
            self._exit_stack.close()

    def _download(self, source: RemotePath) -> None:
        """Download an object; parts are joined to one file."""
        whole = _PART.sub("", source.name)
        file = self.path / whole
        with file.open("ab") as target:
            target.writelines(fetch(source)[1])
        os.utime(file, (source.stat().st_mtime,) * 2)  # the latest row of an input counts
        self._objects.setdefault(whole, []).append(source.name)

    def _upload_rows(self, out: RemotePath) -> None:
        self._uploaded_s = time.monotonic()
        for file in self.path.glob(".depthcli-batch*.jsonl"):
            size, uploaded = file.stat().st_size, self._uploaded.get(file.name, 0)
            if size <= uploaded:
                continue
            part = f"{file.name}.{time.time_ns():020}-{os.urandom(4).hex()}"
            with atomic_path(out / part) as temporary, file.open("rb") as journal:
                journal.seek(uploaded)
                temporary.write_bytes(journal.read(size - uploaded))
            self._uploaded[file.name] = size
            self._objects.setdefault(file.name, []).append(part)


def _row_objects(out: RemotePath) -> Iterator[str]:
    for prefix in _PREFIXES:
        for name in out.walk_names(prefix):
            if not name.startswith(prefix):
                break
            if _NAME.fullmatch(_PART.sub("", name)):
                yield name


_SCHEMA = (
    "PRAGMA cache_size = -65536",  # KiB
    "PRAGMA journal_mode = OFF",
    "CREATE TABLE rows (name BLOB PRIMARY KEY, source INT, position INT) WITHOUT ROWID",
    "CREATE TABLE outputs (path BLOB PRIMARY KEY) WITHOUT ROWID",
    "BEGIN",
)


class Rows:
    """Rows of files by input; the last one of an input counts. Thread-safe.

    Their places (file, position) are in an SQLite database: in memory up to a few megabytes, then
    in a temporary file that is deleted with the process.
    """

    def __init__(
        self, paths: Iterable[Path], shard: Shard = WHOLE, folder: RowsFolder | None = None
    ) -> None:
        """Index the rows of a shard's inputs, and keep the folder while they are in use."""
        self._files, self._shard, self._folder = list[BinaryIO](), shard, folder
        self._lock = threading.Lock()
        self._database = sqlite3.connect("", check_same_thread=False, isolation_level=None)
        for line in _SCHEMA:
            self._database.execute(line)
        for path in paths:
            self._add_file(path)

    def _add_file(self, path: Path) -> None:
        size, source, file = regular_size(path), len(self._files), path.open("rb")
        self._files.append(file)
        if size and not is_journal(path) and next(_rows_in(file), None) is None:
            raise UsageError(
                f"{path} was not written by depthcli", "move it away, or choose another {out}"
            )
        self._index((name, source, at) for name, at in _rows_in(file) if self._shard.holds(name))

    @property
    def has_files(self) -> bool:
        """Whether there is any file of rows."""
        return bool(self._files)

    def row(self, name: str) -> ManifestRow | None:
        """The row of an input, if it has one."""
        query = "SELECT source, position FROM rows WHERE name = ?"
        with self._lock:
            place = self._database.execute(query, (_key(name),)).fetchone()
            return None if place is None else self._at(place)

    def __iter__(self) -> Iterator[ManifestRow]:
        query = "SELECT source, position FROM rows ORDER BY 1, 2"
        return filter(None, map(self._at, self._database.execute(query)))

    def _index(self, rows: Iterable[tuple[str, int, int]]) -> None:
        """Set the places of the rows of inputs, replacing earlier ones."""
        values = ((_key(name), *place) for name, *place in rows)
        self._database.executemany("INSERT OR REPLACE INTO rows VALUES (?, ?, ?)", values)

    def _at(self, place: tuple[int, int]) -> ManifestRow | None:
        source, position = place
        self._files[source].seek(position)
        return parse_row(self._files[source].readline())


def _key(name: str) -> bytes:
    return name.encode("utf-8", "surrogatepass")


def known_rows(folder: Path, shard: Shard = WHOLE) -> Rows:
    """The rows of earlier batches in an output folder, which is not changed."""
    source = RowsFolder(folder)
    with _write_errors(folder):
        return Rows(row_files(source.path, shard), shard, source)


class Journal(Rows):
    """The rows of a running batch.

    Attributes:
        manifest: the file that the rows are written to at the end.
    """

    def __init__(self, folder: Path, shard: Shard = WHOLE) -> None:
        """Open or create the journal of an output folder, which is created if it is missing."""
        self._path = folder / shard.journal_name
        self.manifest = folder / shard.manifest_name
        with ExitStack() as opened, _write_errors(self._path):
            folder.mkdir(parents=True, exist_ok=True)
            if not opened.enter_context(folder_lock(folder, shared=shard != WHOLE)):
                raise _busy_error(folder)
            files = row_files(folder, shard)
            self._earlier = [path for path in files if path != self._path]
            super().__init__(self._earlier, shard)
            handle = open_locked(self._path)
            if handle is None:
                raise _busy_error(folder)
            self._end = opened.enter_context(os.fdopen(handle, "ab", buffering=0))
            self._add_file(self._path)
            for file in self._files:
                opened.enter_context(file)
            if self._end.tell():
                self._files[-1].seek(-1, os.SEEK_END)
                if self._files[-1].read(1) != b"\n":  # the batch was killed in the middle of a line
                    append_whole(self._end, b"\n")
            self._opened = opened.pop_all()

    def add(self, row: ManifestRow) -> None:
        """Append a row, which replaces the input's earlier one."""
        with _write_errors(self._path), self._lock:
            position = append_whole(self._end, row.as_line())
            self._index([(row.input, len(self._files) - 1, position)])

    def finish(self, names: Iterable[str] | None, *, keep_failed: bool = False) -> None:
        """Write the manifest and remove the journal.

        Inputs of earlier batches that have outputs here come last, so that they are not done again
        after a batch of other files of the same folder, unless an output is now that of another
        input. The rows of shards become part of the manifest of a batch that is not divided.

        Names are those of the inputs in the manifest's order; None for all, in the order of their
        names. After a batch of a part of the files, failed inputs of earlier batches are kept.
        """
        with atomic_path(self.manifest) as temporary, temporary.open("wb") as file:
            file.writelines(row.as_line() for row in self._rows(names, keep_failed=keep_failed))
        with _write_errors(self._path), self._opened:
            self._path.unlink(missing_ok=True)  # before another batch can lock it
            for path in self._earlier:
                if path != self.manifest and self._shard.owns(path):
                    path.unlink(missing_ok=True)

    def _rows(self, names: Iterable[str] | None, *, keep_failed: bool) -> Iterator[ManifestRow]:
        """Rows of the names in their order, each once, then the others that still hold."""
        execute, executemany = self._database.execute, self._database.executemany
        for name in names or ():
            row = self.row(name)
            if row is not None:
                paths = ((_key(file.path),) for file in row.outputs)
                executemany("INSERT OR IGNORE INTO outputs VALUES (?)", paths)
                yield row
                execute("DELETE FROM rows WHERE name = ?", (_key(name),))
        taken = "SELECT 1 FROM outputs WHERE path = ?"
        for place in execute("SELECT source, position FROM rows ORDER BY name"):
            row = self._at(place)
            if row is None or any(
                execute(taken, (_key(file.path),)).fetchone() for file in row.outputs
            ):
                continue
            if row.outputs or keep_failed or names is None:
                yield row


def _write_errors(path: Path) -> AbstractContextManager[None]:
    return os_errors_as(OutputError, f"cannot write {path}", "choose another {out}")


def _busy_error(folder: Path) -> UsageError:
    return UsageError(
        f"another batch is writing to {folder}", "wait for it, or choose another {out}"
    )
