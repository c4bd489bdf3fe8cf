"""Temporary files: those of this process, and those that a killed one left.

A process has its own locked, so that a run can tell what killed ones left beside its outputs from
what a live one writes.
"""

import hashlib
import os
import re
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path

from depthcli.io.storage.lock import open_locked

_NAME = r"(?s)\.depthcli-[0-9a-f]{16}(?:\..*)?"
_FORGOTTEN_S = 86_400.0
"""Where there are no locks, only the age of a file tells that nobody writes it."""
_MOST_ENTRIES = 10_000
"""Looking through a folder of any size would cost more than the files that may lie there."""
_SETTLING_S = 0.02
"""Threads that have a name and are about to open the file have done so by then."""
_PATIENCE_S = 1.0
"""For a thread that keeps the lock: it waits for a disk that does not answer, or ends the process
already, and waits for whoever reads its output."""

_lock = threading.RLock()  # for a signal handler, which may come while its own thread has it
_own: set[Path] = set()
_searched: set[Path] = set()


@contextmanager
def temporary_beside(path: Path) -> Iterator[Path]:
    """A name in the same folder, and nothing under it when the block fails, or the process ends.

    It follows from the path's, so that what a killed process left is written over by the next; and
    it is locked, so that of two processes at the same output one takes a name of its own. What else
    killed processes left in the folder goes first.
    """
    with _lock:
        is_new = path.parent not in _searched
        _searched.add(path.parent)
    if is_new:
        remove_stale(path.parent, most=_MOST_ENTRIES)
    usual, other = hashlib.sha256(os.fsencode(path.name)).hexdigest()[:16], os.urandom(8).hex()
    temporary = path.with_name(f".depthcli-{usual}{path.suffix}")
    handle = _claimed(temporary)
    if handle is None:
        temporary = path.with_name(f".depthcli-{other}{path.suffix}")
        handle = _claimed(temporary)
    with _lock:
        _own.add(temporary)
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


def _claimed(temporary: Path) -> int | None:
    """The lock of a temporary file, which is ours then; None if it cannot be had."""
    if sys.platform == "win32":  # which does not rename what is open
        return None
    handle = None
    with _lock:
        is_new = not os.path.lexists(temporary)
        if is_new:
            _own.add(temporary)  # a signal may come as soon as it is there, and in this thread
        with suppress(OSError):  # another user's, or the folder cannot be written to
            handle = open_locked(temporary)
        if handle is not None:
            _own.add(temporary)
        elif is_new:
            _own.discard(temporary)
    return handle


def remove_own() -> None:
    """Remove this process's temporary files; no thread begins or ends one any more.

    The process must end now: those threads wait for ever.
    """
    _lock.acquire(timeout=_PATIENCE_S)
    for path in tuple(_own):
        _remove(path)
    time.sleep(_SETTLING_S)
    for path in tuple(_own):
        _remove(path)


def remove_stale(folder: Path, most: int | None = None) -> None:
    """Remove what killed processes left in a folder.

    Args:
        folder: where to look, not below it.
        most: entries to look at; None for all.
    """
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in islice(entries, most):
            if re.fullmatch(_NAME, entry.name):
                with suppress(OSError):  # a link, a folder, or another user's
                    _remove_stale(Path(entry.path))


def _remove_stale(path: Path) -> None:
    handle = open_locked(path)
    if handle is None:
        return
    try:
        second = open_locked(path)
        if second is not None:  # there are no locks here
            os.close(second)
        if second is None or time.time() - path.stat().st_mtime > _FORGOTTEN_S:
            _remove(path)
    finally:
        os.close(handle)


def _remove(path: Path) -> None:
    with suppress(OSError):  # the folder is gone or read-only: there is nothing to remove
        path.unlink(missing_ok=True)
