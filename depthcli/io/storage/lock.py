"""Locks on files and folders, which are released when the process ends, even if it is killed."""

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_FLAGS = os.O_RDWR | os.O_CREAT | os.O_APPEND
# No link is followed and no pipe waited for; Windows has neither, but changes line ends.
for _name in ("O_NOFOLLOW", "O_NONBLOCK", "O_BINARY"):
    _FLAGS |= getattr(os, _name, 0)


def lock(handle: int, *, shared: bool = False) -> bool:
    """Lock an open file, exclusively or shared.

    Returns:
        Whether it was free; True as well where locks are not supported, such as on some network
        file systems.
    """
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
    """Open or create a file to read and append to, and lock it; None if it is locked already.

    Raises:
        OSError: it cannot be opened, or is a link, a pipe, a device or a folder.
    """
    while True:
        handle = _opened(path)
        is_ours = lock(handle)
        if is_ours and _is_at(path, handle):
            return handle
        os.close(handle)
        if not is_ours:
            return None  # else the process that had it replaced or removed it: try again


def _opened(path: Path) -> int:
    try:
        handle = os.open(path, _FLAGS, 0o666)
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise OSError(errno.ELOOP, "it is a link; remove it", path) from error
        raise
    if stat.S_ISREG(os.fstat(handle).st_mode):
        return handle
    os.close(handle)
    raise OSError(errno.EINVAL, "it is a pipe or a device; remove it", path)


def _is_at(path: Path, handle: int) -> bool:
    try:
        return os.path.samestat(path.lstat(), os.fstat(handle))
    except FileNotFoundError:
        return False
