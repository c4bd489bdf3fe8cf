"""Uploading and downloading whole files."""

import errno
import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.errors import DepthcliError, InputError
from depthcli.io.storage import objects
from depthcli.io.storage.paths import RemotePath
from depthcli.io.storage.temporary import temporary_folder

SHA256_KEY = "sha256"


@contextmanager
def local_copy(
    path: Path, progress: Progress = NO_PROGRESS, *, max_bytes: int | None = None
) -> Iterator[Path]:
    """A local copy of a remote file, for libraries that need one; a local path is not copied.

    The copy has the same name, and is removed after the block, whose errors name the path, not the
    copy.

    Raises:
        InputError: it cannot be read, or has more than ``max_bytes``.
    """
    if not isinstance(path, RemotePath):
        yield path
        return
    with temporary_folder() as folder:
        copy = folder / path.name
        try:
            download(path, copy, progress, max_bytes=max_bytes)
        except OSError as error:
            raise InputError(f"{path} cannot be read: {error.strerror}") from error
        try:
            yield copy
        except DepthcliError as error:
            raise type(error)(str(error).replace(str(copy), str(path))) from error


def download(
    path: RemotePath, file: Path, progress: Progress = NO_PROGRESS, *, max_bytes: int | None = None
) -> None:
    """Download an object to a file, with a few megabytes in memory."""
    content = objects.parts(path.address)
    size = int(next(content))
    if max_bytes is not None and size > max_bytes:
        raise OSError(errno.EFBIG, f"it has more than {max_bytes:,} bytes", str(path))
    advance = progress.begin(path.name, size, "bytes")
    with file.open("wb") as target:
        for part in content:
            target.write(part)
            advance(len(part))


@contextmanager
def uploaded(path: RemotePath) -> Iterator[Path]:
    """A file to write, which is uploaded when the block succeeds, with its checksum as metadata."""
    with temporary_folder() as folder:
        file = folder / path.name
        yield file
        with file.open("rb") as content:
            digest = hashlib.file_digest(content, "sha256").hexdigest()
        objects.put(path.address, file, {SHA256_KEY: digest})


def object_checksum(path: RemotePath) -> tuple[int, str] | None:
    """Size and SHA-256 of an object, read only without a checksum in its metadata; None if none."""
    try:
        known = objects.object_info(path.address)
        digest = known.metadata.get(SHA256_KEY) or hashlib.sha256(path.read_bytes()).hexdigest()
    except FileNotFoundError:
        return None
    return known.size, digest
