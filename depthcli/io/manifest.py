"""Rows of a batch's inputs: the manifest, and the journal from which a killed batch is resumed.

Rows are appended line by line to the journal, a hidden file. When the batch ends without being
killed, they are written to the manifest atomically. Manifests are summed up and merged.
"""

import hashlib
import json
import os
import re
import threading
import time
from collections import Counter
from collections.abc import Container, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Annotated, Any, Self

from depthcli.core import options, validation
from depthcli.errors import Message, OutputError, UsageError, os_errors_as
from depthcli.io.storage.atomic import append_whole, atomic_path, folder_lock, open_locked
from depthcli.io.storage.paths import RemotePath, object_checksum, regular_size

OK = "ok"
FAILED = "failed"
_SECONDS = options.Rule("a number from 0 to 1e9", lambda number: 0 <= number <= 1e9)  # noqa: PLR2004


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
class KnownDepthEntry:
    """The known points that the depth of an input was fitted to."""

    given: int  #: all points
    used: int  #: those that depth was fitted to; the others contradict them
    residual_m: float  #: median absolute difference of all points, in metres
    sha256: str  #: checksum of the points, 64 hex digits
    fit: options.DepthFit | None = None  #: how depth follows them; None if that is not known
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
    #: full path of the input, or its URI without password and signature; None in older manifests
    input_path: str | None = None
    error: str | None = None  #: why it failed; None if it did not
    warnings: tuple[str, ...] = ()  #: one-line texts
    #: the camera that its metres are for, and how it is known; None without metres
    camera: str | None = None
    anchors: KnownDepthEntry | None = None  #: the known points it was fitted to; None if it was not

    def as_json(self) -> dict[str, object]:
        """The fields of one line."""
        # Not dataclasses.asdict, which copies so deeply that it takes as long as a checksum.
        fields = _fields(self) | {
            "outputs": [_fields(file) for file in self.outputs],
            "seconds": round(self.seconds, 6),
            "anchors": self.anchors and _fields(self.anchors),
        }
        del fields["key"]
        return fields | _fields(self.key)

    def as_line(self) -> bytes:
        """One line; names with bytes that are not UTF-8 are escaped as Python does."""
        return json.dumps(self.as_json(), ensure_ascii=True).encode() + b"\n"


def _fields(entry: KnownDepthEntry | CacheKey | ManifestRow | OutputFile) -> dict[str, object]:
    return {name: getattr(entry, name) for name in entry.__slots__}


def parse_row(line: bytes) -> ManifestRow | None:
    """A row from its line; None if it is incomplete or not a row."""
    try:
        fields: Any = validation.parsed_json(line)
        key = {name: fields.pop(name) for name in CacheKey.__slots__}
        return validation.validated(ManifestRow, {**fields, "key": key})
    except (validation.FieldError, TypeError, KeyError, AttributeError):
        return None


def checksum(path: Path) -> tuple[int, str] | None:
    """Size and SHA-256 of a file on disk; None if there is none."""
    if isinstance(path, RemotePath):
        with os_errors_as(OutputError, f"{path} cannot be checked"):
            return object_checksum(path)
    with suppress(OSError):
        size = regular_size(path)
        with path.open("rb") as file:
            return size, hashlib.file_digest(file, "sha256").hexdigest()
    return None


def output_entry(folder: Path, path: Path) -> OutputFile:
    """The entry of a file just written."""
    size_and_checksum = checksum(path)
    if size_and_checksum is None:
        raise OutputError(f"{path} is gone, or cannot be read, after it was written")
    return OutputFile(path.relative_to(folder).as_posix(), *size_and_checksum)


_PREFIXES = (".depthcli-batch", "manifest")
_NAME = re.compile(r"(\.depthcli-batch|manifest)(-\d+-of-\d+)?\.jsonl(\.\d{20}-[0-9a-f]{8})?")
_UPLOAD_INTERVAL_S = 5.0


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


WHOLE = Shard()


def is_journal(path: Path) -> bool:
    """Whether a file is the journal of a batch or of a part of one."""
    return path.name.startswith(_PREFIXES[0])


def row_files(folder: Path) -> list[Path]:
    """The manifests and journals in a folder, of all shards, the latest last."""
    times_s = dict[Path, float]()
    for name in filter(_NAME.fullmatch, _names_in(folder)):
        with suppress(FileNotFoundError):  # another shard has just ended
            times_s[folder / name] = (folder / name).stat().st_mtime
    return sorted(times_s, key=lambda path: (times_s[path], path.name))


def _names_in(folder: Path) -> Iterator[str]:
    for prefix in _PREFIXES:
        if not isinstance(folder, RemotePath):
            yield from (path.name for path in folder.glob(f"{prefix}*"))
            continue
        for name in folder.walk_names(prefix):
            if not name.startswith(prefix):
                break
            yield name


class Rows:
    """The last row of each input in some files, as a line that is parsed when it is needed.

    Attributes:
        has_files: whether there is any file.
    """

    def __init__(
        self, paths: Iterable[Path], shard: Shard = WHOLE, batch: Container[str] = ()
    ) -> None:
        """Read the rows of a shard's inputs, and of all inputs outside the batch.

        The names of the batch are those of the inputs of all its shards.
        """
        self._shard, self._batch, self.has_files = shard, batch, False
        self._lines: dict[str, bytes] = {}  # by input
        for path in paths:
            with suppress(FileNotFoundError):  # another shard has just ended
                self._read(path)

    def _read(self, path: Path) -> None:
        with path.open("rb") as file:
            is_row = map(parse_row, () if is_journal(path) else file)
            if not any(is_row) and file.tell():
                raise UsageError(
                    f"{path} was not written by depthcli", "move it away, or choose another {out}"
                )
            file.seek(0)
            self.has_files = True
            for line in file:
                name = _input_of(line)
                if name is not None and (self._shard.holds(name) or name not in self._batch):
                    self._lines[name] = line

    def row(self, name: str) -> ManifestRow | None:
        """The row of an input, if it has one."""
        line = self._lines.get(name)
        return None if line is None else parse_row(line)

    def __iter__(self) -> Iterator[ManifestRow]:
        return filter(None, map(parse_row, self._lines.values()))

    @property
    def others(self) -> Iterator[ManifestRow]:
        """The rows of inputs outside the batch."""
        names = (name for name in self._lines if name not in self._batch)
        return filter(None, map(self.row, names))


def _input_of(line: bytes) -> str | None:
    """The input of a row; None if the line is incomplete or not a row."""
    try:
        fields: Any = validation.parsed_json(line)
        name = fields["input"]
    except (validation.FieldError, TypeError, KeyError):
        return None
    return name if isinstance(name, str) else None


def known_rows(folder: Path, shard: Shard = WHOLE, batch: Container[str] = ()) -> Rows:
    """The rows of earlier batches in an output folder, which is not changed."""
    with _write_errors(folder):
        return Rows(row_files(folder), shard, batch)


class Journal(Rows):
    """The rows of a running batch. Thread-safe.

    Objects cannot be appended to: in a store, new rows are uploaded every few seconds as an object
    of their own. The next batch, on any machine, has all but the last rows of a killed one.

    Attributes:
        manifest: the file that the rows are written to at the end.
    """

    def __init__(self, folder: Path, shard: Shard = WHOLE, batch: Container[str] = ()) -> None:
        """Open or create the journal of an output folder, which is created if it is missing."""
        journal, manifest = (f"{prefix}{shard.tag}.jsonl" for prefix in _PREFIXES)
        self._path, self.manifest = folder / journal, folder / manifest
        self._lock = threading.Lock()
        self._waiting, self._uploaded_s = bytearray(), time.monotonic()
        is_local = not isinstance(folder, RemotePath)
        with ExitStack() as opened, _write_errors(self._path):
            folder.mkdir(parents=True, exist_ok=True)
            if is_local and not opened.enter_context(folder_lock(folder, shared=shard != WHOLE)):
                raise _busy_error(folder)
            self._files = [path for path in row_files(folder) if path != self._path]
            super().__init__(self._files, shard, batch)
            self._file = opened.enter_context(self._open()) if is_local else None
            self._opened = opened.pop_all()

    def _open(self) -> FileIO:
        """The end of the file, whose rows are read."""
        handle = open_locked(self._path)
        if handle is None:
            raise _busy_error(self._path.parent)
        file = os.fdopen(handle, "ab", buffering=0)
        self._files.append(self._path)
        self._read(self._path)
        if file.tell():
            append_whole(file, b"\n")  # ends a line in which the batch was killed
        return file

    def add(self, row: ManifestRow) -> None:
        """Append a row, which replaces the input's earlier one."""
        line = row.as_line()
        with _write_errors(self._path), self._lock:
            if self._file:
                append_whole(self._file, line)
            else:
                self._waiting += line
                now_s = time.monotonic()
                if now_s - self._uploaded_s >= _UPLOAD_INTERVAL_S:
                    part = f"{self._path.name}.{time.time_ns():020}-{os.urandom(4).hex()}"
                    self._files.append(self._path.with_name(part))
                    with atomic_path(self._files[-1]) as temporary:
                        temporary.write_bytes(self._waiting)
                    self._waiting, self._uploaded_s = bytearray(), now_s
            self._lines[row.input] = line

    def finish(self, names: Iterable[str] | None, *, keep_failed: bool = False) -> None:
        """Write all rows to the manifest, and remove the journal.

        The rows of this batch come first. Those of earlier batches into the folder follow, sorted
        by name, so that a later batch finds them; a row is left out if one of its outputs is now
        that of another input. A batch without shards also removes the manifests of shards.

        Args:
            names: the inputs of this batch in the order of their rows; None for all that have a
                row, sorted.
            keep_failed: whether rows without outputs of earlier batches are kept.
        """
        with atomic_path(self.manifest) as temporary, temporary.open("wb") as file:
            names = sorted(self._lines) if names is None else names
            file.writelines(row.as_line() for row in self._final(names, keep_failed=keep_failed))
        with _write_errors(self._path), self._opened:
            for path in reversed(self._files):  # the journal before another batch can lock it
                is_own = path.name.startswith(self._path.name)
                if path != self.manifest and (is_own or self._shard == WHOLE):
                    path.unlink(missing_ok=True)

    def _final(self, names: Iterable[str], *, keep_failed: bool) -> Iterator[ManifestRow]:
        outputs = set[str]()
        for name in names:
            row = self.row(name)
            if row is not None:
                outputs.update(file.path for file in row.outputs)
                yield row
                del self._lines[name]  # so that each is written once
        for name in filter(self._shard.holds, sorted(self._lines)):
            row = self.row(name)
            if row is None or not outputs.isdisjoint(file.path for file in row.outputs):
                continue
            if row.outputs or keep_failed:
                yield row


def _write_errors(path: Path) -> AbstractContextManager[None]:
    return os_errors_as(OutputError, f"cannot write {path}", "choose another {out}")


def _busy_error(folder: Path) -> UsageError:
    return UsageError(
        f"another batch is writing to {folder}", "wait for it, or choose another {out}"
    )


@dataclass(frozen=True, slots=True)
class Summary:
    """Sums over the rows of a manifest."""

    inputs: int
    failed: int
    outputs: int  #: files
    output_bytes: int
    seconds: float  #: processing time of all inputs, each from opening it to its last output
    #: name and checksum of each model, version of depthcli, and number of inputs it processed
    models: tuple[dict[str, str | int], ...]


def read_rows(path: Path) -> Rows:
    """The latest row of each input in a manifest, or in an output folder with all its shards."""
    with os_errors_as(UsageError, f"cannot read the manifest {path}"):
        rows = known_rows(path) if path.is_dir() else Rows([path])
    if not rows.has_files:
        raise UsageError(f"no manifest in {path}", "name the output folder of a batch")
    return rows


def damage(path: Path) -> Message | None:
    """The problem of lines that are no rows in a manifest, or in those of a folder."""
    for file in row_files(path) if path.is_dir() else [path]:
        if is_journal(file):
            continue
        with file.open("rb") as lines:
            damaged = [number for number, line in enumerate(lines, 1) if parse_row(line) is None]
        if damaged:
            return Message(
                f"{file}: line {damaged[0]} is no row, and {len(damaged) - 1} others are none",
                "remove them, and the next batch processes their inputs again",
            )
    return None


def summarize(rows: Rows) -> Summary:
    """Sums over all rows."""
    models: Counter[tuple[str, str, str]] = Counter()
    failed = outputs = output_bytes = 0
    seconds = 0.0
    for row in rows:
        failed += row.status == FAILED
        outputs += len(row.outputs)
        output_bytes += sum(file.bytes for file in row.outputs)
        seconds += row.seconds
        models[row.key.model, row.key.model_sha256, row.key.version] += 1
    names = ("model", "model_sha256", "version")
    by_model = tuple(dict(zip(names, m, strict=True)) | {"inputs": n} for m, n in models.items())
    return Summary(models.total(), failed, outputs, output_bytes, round(seconds, 6), by_model)


def merge_manifests(folder: Path) -> Path:
    """Merge the manifests of shards and the journals of killed batches; returns the manifest.

    UsageError if there is none, or a batch is running there.
    """
    if not row_files(folder):
        raise UsageError(f"no manifest in {folder}", "name the output folder of a batch")
    if problem := damage(folder):
        raise UsageError(problem)
    journal = Journal(folder)
    journal.finish(None)
    return journal.manifest
