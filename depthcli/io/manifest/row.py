"""The rows of a batch's manifest: the result of each input."""

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from depthcli.core.options import Rule
from depthcli.core.validation import FieldError, parsed_json, validated
from depthcli.errors import OutputError
from depthcli.io.storage.paths import RemotePath, regular_size

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
        return row_of(parsed_json(line))
    except FieldError:
        return None


def row_of(fields: Any) -> ManifestRow | None:  # noqa: ANN401 - what JSON can hold
    """A row from its fields, which are consumed; None if they are not those of a row."""
    try:
        key = {name: fields.pop(name) for name in CacheKey.__slots__}
        return validated(ManifestRow, {**fields, "key": key})
    except (FieldError, TypeError, KeyError, AttributeError):
        return None


def checksum(path: Path) -> OutputFile | None:
    """Size and checksum of a file on disk, with its path; None if there is none."""
    try:
        if isinstance(path, RemotePath):
            from depthcli.io.storage.transfer import object_checksum  # noqa: PLC0415 - seldom used

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
