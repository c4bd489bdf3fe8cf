"""Writing files: complete or not at all, over temporary files that no process leaves behind.

A process locks its temporary files, so that another one can tell stale ones, which killed processes
left, from those that are being written.
"""

import os
import re
import shutil
import stat
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path
from typing import TypeAlias

from depthcli.core.parallel import exit_hook
from depthcli.errors import OutputError, UsageError, os_errors_as
from depthcli.io.storage.objects import RemotePath, put

NO_ROOM = "cannot write a temporary file", "set TMPDIR"  #: problem and advice


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder in the system's temporary one, removed when the block or the process ends."""
    from tempfile import TemporaryDirectory  # noqa: PLC0415 - 2 ms, and seldom used

    with os_errors_as(OutputError, *NO_ROOM):
        folder = TemporaryDirectory(prefix="depthcli-")
    with exit_hook(folder.cleanup), folder as name:
        yield Path(name)


_FLAGS = os.O_RDWR | os.O_CREAT | os.O_APPEND
# No link is followed and no pipe waited for; Windows has neither, but changes line ends.
for _name in ("O_NOFOLLOW", "O_NONBLOCK", "O_BINARY"):
    _FLAGS |= getattr(os, _name, 0)


def lock(handle: int, *, shared: bool = False) -> bool:
    """Lock an open file; returns whether it was free, or the file system has no locks."""
    try:
        import fcntl  # noqa: PLC0415 - not on Windows
    except ImportError:
        return True
    try:
        fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


@contextmanager
def folder_lock(folder: Path, *, shared: bool = False) -> Iterator[bool]:
    """Lock a folder for the block, exclusively or shared; yields whether it was free."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except PermissionError:  # Windows opens no folders
        yield True
        return
    try:
        yield lock(handle, shared=shared)
    finally:
        os.close(handle)


def open_locked(path: Path) -> int | None:
    """Open or create a file to append to, and lock it; None if locked, OSError for links."""
    while True:
        handle = os.open(path, _FLAGS, 0o666)
        is_ours = lock(handle)
        with suppress(FileNotFoundError):
            if is_ours and os.path.samestat(path.lstat(), os.fstat(handle)):
                return handle
        os.close(handle)
        if not is_ours:
            return None  # else the process that had it replaced or removed it: try again


_NAME = r"(?s)\.depthcli-[0-9a-f]{16}(?:\..*)?"
_SETTLE_S = 0.02  # by then, threads that were about to open a temporary file have done so
_LOCK_TIMEOUT_S = 1.0  # a thread may keep the lock while it waits for a disk or a reader

_lock = threading.RLock()  # a signal handler may need it while its own thread holds it
_own: set[Path] = set()
_searched: set[Path] = set()


@contextmanager
def temporary_beside(path: Path) -> Iterator[Path]:
    """A temporary path in the same folder; its file is removed if the block or the process fails.

    It is locked, so that other processes do not take it for stale. Stale files in the folder are
    removed first.
    """
    with _lock:
        is_new = path.parent not in _searched
        _searched.add(path.parent)
    if is_new:
        remove_stale(path.parent)
    temporary = path.with_name(f".depthcli-{os.urandom(8).hex()}{path.suffix}")
    handle = None
    with _lock:
        _own.add(temporary)  # a signal may arrive as soon as it exists, even in this thread
        # Windows does not rename what is open; a folder may be read-only.
        with suppress(OSError):
            handle = None if sys.platform == "win32" else open_locked(temporary)
    try:
        yield temporary
    except BaseException:
        _remove(temporary)
        raise
    finally:
        if handle is not None:
            os.close(handle)
        with _lock:
            _own.discard(temporary)


def remove_own() -> None:
    """Remove this process's temporary files, and keep other threads from creating more.

    The process must end now: those threads wait forever.
    """
    _lock.acquire(timeout=_LOCK_TIMEOUT_S)
    for path in tuple(_own):
        _remove(path)
    time.sleep(_SETTLE_S)
    for path in tuple(_own):
        _remove(path)


def remove_stale(folder: Path) -> None:
    """Remove temporary files of killed processes in a folder."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if re.fullmatch(_NAME, entry.name):
                with suppress(OSError):  # a link, a folder, or another user's
                    _remove_stale(Path(entry.path))


def _remove_stale(path: Path) -> None:
    handle = open_locked(path)
    if handle is None:
        return
    try:
        second = open_locked(path)
        if second is None:
            _remove(path)
        else:  # locks are not supported here, so that it may be in use
            os.close(second)
    finally:
        os.close(handle)


def _remove(path: Path) -> None:
    with suppress(OSError):  # the folder is gone or read-only: there is nothing to remove
        path.unlink(missing_ok=True)


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
            with temporary_folder() as folder:
                file = folder / path.name
                yield file
                put(path, file)
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
