"""Names of local and remote files, reading them whole, and folders of the user."""

import errno
import hashlib
import math
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Literal
from urllib.parse import unquote, urlsplit

from depthcli.core.parallel import NO_PROGRESS, Progress
from depthcli.errors import DepthcliError, InputError, UsageError, os_errors_as
from depthcli.io.storage import atomic, objects
from depthcli.io.storage.objects import SHA256_KEY, RemotePath

__all__ = ["RemotePath"]

SCHEMES = ("s3", "gs", "az", "http", "https")
_HTTP = ("http", "https")
_STREAMS = ("rtsp", "rtsps")
_MB = 1e6
_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")


def without_file_scheme(name: str | os.PathLike[str]) -> str:
    """A ``file://`` URI as a path; any other name as text, unchanged."""
    text = os.fspath(name)
    return os.fspath(path_of(text)) if text.lower().startswith("file://") else text


def path_of(name: str | os.PathLike[str]) -> Path:
    """The local or remote path of a plain path, or of a URI of :data:`SCHEMES` or ``file://``.

    Raises:
        UsageError: it is a URI of another kind, has no bucket or host, or has a key that no path
            can hold.
    """
    if isinstance(name, Path):
        return name
    text = os.fspath(name)
    match = _SCHEME.match(text)
    if match is None:
        return Path(text)
    scheme = match[1].lower()
    if scheme == "file":
        parts = urlsplit(text)
        if parts.netloc not in {"", "localhost"}:
            raise UsageError(f"{text} names a host; write file:///folder/name")
        return Path(unquote(parts.path))
    if scheme not in SCHEMES:
        raise UsageError(
            f"{objects.masked(text)}: unknown scheme {match[1]}://; use "
            f"{'://, '.join(SCHEMES)}:// or file://, or copy it to a local folder"
        )
    rest, _, query = text[match.end() :].partition("?" if scheme in _HTTP else "\0")
    if rest.startswith("/") or not rest:
        where = "host" if scheme in _HTTP else "bucket"
        raise UsageError(f"{objects.masked(text)} has no {where}; write {scheme}://{where}/name")
    # A path would leave out these parts, and so name another object.
    if scheme not in _HTTP and {"", ".", ".."} & {*rest.removesuffix("/").split("/")}:
        raise UsageError(f"{text}: a key with an empty, '.' or '..' part cannot be used")
    path = RemotePath(f"{scheme}://{rest}")
    path.query = query
    return path


def join(folder: str, name: str) -> str:
    """A name joined to a folder, which may be remote; an absolute or remote name unchanged."""
    if _SCHEME.match(name):
        return name
    if _SCHEME.match(folder) and not os.path.isabs(name):  # noqa: PTH117 - any string
        return f"{folder.rstrip('/')}/{name.removeprefix('./')}"
    return os.path.join(folder, name)  # noqa: PTH118 - keeps "./" and names with any byte


def safe_name(name: str) -> str:
    """A name for messages and reports: a URI without its password and its signature."""
    scheme = _SCHEME.match(name)
    if scheme is not None and scheme[1].lower() in _STREAMS:
        return objects.masked(name)
    return str(path_of(name)) if scheme else name


def check_writable(path: Path) -> None:
    """Check that an output path can be written to, before any work is done."""
    if isinstance(path, RemotePath) and path.is_http:
        raise UsageError(f"{path} is behind HTTP, where nothing is written", "give another {out}")


def read_regular(path: Path, max_bytes: int, *, first: int = -1) -> bytes:
    """Content, or ``first`` bytes, of a regular file of up to ``max_bytes``; else OSError."""
    if isinstance(path, RemotePath):
        return path.read_bytes(max_bytes, first=first)
    size = regular_size(path)
    if size > max_bytes:
        raise OSError(errno.EFBIG, f"it has more than {max_bytes:,} bytes", path)
    # Python allocates as many bytes as are requested, so ``max_bytes`` are not.
    with path.open("rb") as file:
        return file.read(size if first < 0 else min(first, size))


_MAX_INPUT_BYTES = 2**32  # more than an image of 250 million pixels takes in float32 RGB


def read_bytes(path: Path, first: int = -1) -> bytes:
    """Content of an input file, or its ``first`` bytes."""
    try:
        return read_regular(path, _MAX_INPUT_BYTES, first=first)
    except OSError as error:
        problem, advice = f"cannot be read: {error.strerror}", ""
        if isinstance(error, IsADirectoryError):
            problem, advice = "is a folder", "name the files in it, or give it to 'depthcli batch'"
        elif isinstance(error, FileNotFoundError) and not isinstance(path, RemotePath):
            problem = "is a broken link" if path.is_symlink() else "is missing: no such file"
        raise InputError(f"{path} {problem}", advice) from None


def regular_size(path: Path) -> int:
    """Size of a regular file in bytes; pipes, devices and ``/proc/kmsg`` may never end."""
    try:
        status = path.stat()
    except ValueError as error:  # a NUL byte, or what no file system can hold
        raise OSError(errno.EINVAL, f"no file has such a name ({error})", path) from None
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder", path)
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is a pipe or a device; copy it to a file", path)
    return status.st_size


_PROGRAM = "depthcli"


def user_folder(kind: Literal["data", "config"]) -> Path:
    """The platform's folder for an application's data, models, or settings, such as cameras."""
    from platformdirs import PlatformDirs  # noqa: PLC0415 - takes 10 ms

    folders = PlatformDirs(_PROGRAM, appauthor=False, roaming=kind == "config")
    try:
        path = folders.user_data_path if kind == "data" else folders.user_config_path
    except RuntimeError:  # of a container without HOME and account: nothing is kept
        path = Path()
    return path if path.is_absolute() else Path(os.devnull, _PROGRAM)


@contextmanager
def local_copy(
    path: Path, progress: Progress = NO_PROGRESS, *, max_bytes: int | None = None
) -> Iterator[Path]:
    """A copy of a remote file for the block, whose errors name the path, not the copy."""
    if not isinstance(path, RemotePath):
        yield path
        return
    with atomic.temporary_folder() as folder:
        copy = folder / path.name
        with os_errors_as(InputError, f"{path} cannot be read"), copy.open("wb") as file:
            download(path, file, progress, max_bytes=max_bytes)
        with errors_about(path, copy):
            yield copy


@contextmanager
def errors_about(path: Path, copy: Path) -> Iterator[None]:
    """Have the errors of the block name the path that was copied, not its copy."""
    try:
        yield
    except DepthcliError as error:
        problem, advice = (
            text.replace(str(copy), str(path))
            for text in (error.message.problem, error.message.advice)
        )
        raise type(error)(problem, advice, option=error.message.option) from error


def download(
    path: RemotePath, file: BinaryIO, progress: Progress = NO_PROGRESS, *, max_bytes: int | None
) -> None:
    """Append to an open file what it lacks of an object, with a few megabytes in memory."""
    done = file.seek(0, os.SEEK_END)
    size, content = objects.fetch(path, max_bytes, done)
    advance = progress.begin(path.name, math.ceil((size - done) / _MB), "MB")
    for part in content:
        file.write(part)
        advance(len(part) / _MB)


def object_checksum(path: RemotePath) -> tuple[int, str] | None:
    """Size and SHA-256 of an object, read only without a checksum in its metadata; None if none."""
    try:
        size, _, metadata = objects.head(path)
        return size, metadata.get(SHA256_KEY) or hashlib.sha256(path.read_bytes()).hexdigest()
    except FileNotFoundError:
        return None
