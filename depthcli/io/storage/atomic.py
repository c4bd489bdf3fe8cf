"""Writing files: complete or not at all, and over no file of another program."""

import os
import re
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import TypeAlias

from depthcli.errors import OutputError, UsageError, os_errors_as
from depthcli.io.storage.paths import RemotePath, uploaded
from depthcli.io.storage.temporary import folder_lock, temporary_beside

FileIdentity: TypeAlias = tuple[int, int] | str
OUT_ADVICE = "choose another {out}"


def identity_of(path: str | Path) -> FileIdentity:
    """Identity of a file, whatever its names, and links and missing folders that lead to it."""
    if isinstance(path, RemotePath):
        return str(path)
    place = os.path.realpath(path)  # also through folders that do not exist yet
    try:
        status = os.stat(place)  # noqa: PTH116 - names with any byte pass here
    except (OSError, ValueError):
        return place
    return status.st_dev, status.st_ino


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A path of the same suffix in the same folder that takes ``path``'s place after the block.

    Missing folders are created, and any file is replaced; a guard may check the path before.

    Raises:
        OutputError: the folder cannot be created, the file cannot be written, or the path is no
            file. Nothing is left behind.
    """
    if is_special(path):
        raise OutputError(f"{path} is no file and is not replaced", OUT_ADVICE)
    with os_errors_as(OutputError, f"cannot write {path}", OUT_ADVICE):
        if isinstance(path, RemotePath):
            with uploaded(path) as temporary:
                yield temporary
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):
            path.lstat()  # a name that is too long fails before the work
        with temporary_beside(path) as temporary:
            yield temporary
            os.replace(temporary, path)  # noqa: PTH105 - names with bytes that are not UTF-8 pass


def write_text(text: str, path: Path) -> None:
    """Write a file of text, in which names of files may not be UTF-8."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="surrogateescape")


def append_whole(file: FileIO, data: bytes) -> int:
    """Append data to a file, all or nothing; return where it begins."""
    start = file.seek(0, os.SEEK_END)
    try:
        at = 0
        while at < len(data):
            at += file.write(data[at:])
    except OSError:
        with suppress(OSError):
            file.truncate(start)
        raise
    return start


_OPEN_STREAM = re.compile(r"/dev/(stdin|stdout|stderr|fd/\d+)|/proc/(self|\d+)/fd/\d+")


def is_special(path: Path) -> bool:
    """Whether a path is an open stream, or exists and is no file, such as a folder."""
    if isinstance(path, RemotePath):
        return False
    if _OPEN_STREAM.fullmatch(os.path.abspath(path)):  # noqa: PTH100 - links stay as named
        return True  # also one that was redirected to a file: the link would be replaced
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return False  # writing says what is wrong
    return not stat.S_ISREG(mode)


_WORK = ".depthcli-work"


@contextmanager
def workspace(root: Path) -> Iterator[Path]:
    """An empty hidden folder in ``root``, locked by one process and removed after the block.

    New folders are prepared there and then renamed; folders that are moved there are removed. After
    a killed process, the next one clears it.
    """
    work = root / _WORK
    with os_errors_as(OutputError, f"cannot write {root}"):
        root.mkdir(parents=True, exist_ok=True)
        with folder_lock(root) as is_free:
            if not is_free:
                raise UsageError(f"another depthcli is changing {root}; wait for it")
            shutil.rmtree(work, ignore_errors=True)
            work.mkdir()
            try:
                yield work
            finally:
                shutil.rmtree(work, ignore_errors=True)


def replace_folder(new: Path, target: Path, last: str) -> None:
    """Move a new folder to its final path, replacing the files of a folder that is there.

    The file called ``last`` refers to the others and is replaced after them, so that the old folder
    is valid until then; others may have the same name only if they have the same content.
    """
    if not target.is_dir():
        new.rename(target)
        return
    names = {path.name for path in new.iterdir()}
    for name in sorted(names, key=last.__eq__):
        os.replace(new / name, target / name)  # noqa: PTH105 - as in the other files here
    for path in target.iterdir():
        if path.name not in names:
            path.rename(new / path.name)
