"""Temporary files of this process, and stale ones that killed processes left.

A process locks its own, so that another one can tell stale files from those that are being written.
"""

import os
import re
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from depthcli.core.parallel import exit_hook
from depthcli.errors import OutputError, os_errors_as

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
