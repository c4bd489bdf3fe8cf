"""Folders that are made, replaced and removed by steps each of which leaves a whole one."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from depthcli.errors import OutputError, UsageError
from depthcli.io.storage.lock import folder_lock

_WORK, _NEW, _OLD = ".depthcli-work", ".depthcli-new-", ".depthcli-old-"


@contextmanager
def workspace(root: Path) -> Iterator[Path]:
    """An empty hidden folder in ``root``, of one process at a time, that is gone afterwards.

    What is made there is put in its place by a rename, and what is renamed to there is removed. A
    killed process leaves it to the next one.

    Raises:
        OutputError: the folder, or what the block writes, cannot be written.
        UsageError: another process is at work there.
    """
    work = root / _WORK
    try:
        root.mkdir(parents=True, exist_ok=True)
        with folder_lock(root) as is_free:
            if not is_free:
                raise UsageError(f"another depthcli is changing {root}; wait for it")
            _remove_folder(work)
            work.mkdir()
            try:
                yield work
            finally:
                _remove_folder(work)
    except OSError as error:
        raise OutputError(f"cannot write {root}: {error.strerror or error}") from error


@contextmanager
def folder_in_place(target: Path) -> Iterator[Path]:
    """A temporary folder that takes the target's place when the block succeeds.

    One process at a time, which calls :func:`put_back` before it looks for the target.

    Raises:
        OutputError: the folder cannot be made or replaced; what was there stays.
    """
    temporary = target.with_name(f"{_NEW}{target.name}")
    try:
        _remove_folder(temporary)
        temporary.mkdir(parents=True)
        yield temporary
        if target.exists():
            target.rename(_old(target))
        temporary.rename(target)
    except OSError as error:
        raise OutputError(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        put_back(target)
        _remove_folder(temporary)


def put_back(target: Path) -> None:
    """Put a folder back that was moved away for one that did not come, or remove it."""
    if target.exists():
        _remove_folder(_old(target))
        return
    with suppress(OSError):  # there is none, or it stays for the next one to put back
        _old(target).rename(target)


def _remove_folder(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)


def _old(target: Path) -> Path:
    return target.with_name(f"{_OLD}{target.name}")


def put_folder(made: Path, target: Path, last: str) -> None:
    """Let a folder take the place of another, if there is one.

    Args:
        made: the folder.
        target: where it goes.
        last: the file that says which of the others count. Those of the old folder stay until it
            is replaced; so no other file of both may have one name, unless it is the same.
    """
    if not target.is_dir():
        made.rename(target)
        return
    names = {path.name for path in made.iterdir()}
    for name in sorted(names, key=last.__eq__):
        os.replace(made / name, target / name)  # noqa: PTH105 - as in the other files here
    for path in target.iterdir():
        if path.name not in names:
            path.rename(made / path.name)
