"""Creating, replacing and removing folders in steps that never leave an incomplete one."""

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
    """An empty hidden folder in ``root``, locked by one process and removed after the block.

    New folders are prepared there and then renamed; folders that are moved there are removed. After
    a killed process, the next one clears it.

    Raises:
        OutputError: the folder, or what the block writes, cannot be written.
        UsageError: another process has locked it.
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
def atomic_folder(target: Path) -> Iterator[Path]:
    """A temporary folder that takes the target's place when the block succeeds.

    For one process at a time, which calls :func:`restore_folder` before it looks for the target.

    Raises:
        OutputError: the folder cannot be created or replaced; the old one stays.
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
        restore_folder(target)
        _remove_folder(temporary)


def restore_folder(target: Path) -> None:
    """Finish an interrupted replacement: move the old folder back, or remove it if not needed."""
    if target.exists():
        _remove_folder(_old(target))
        return
    with suppress(OSError):  # there is no old folder, or the next process restores it
        _old(target).rename(target)


def _remove_folder(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)


def _old(target: Path) -> Path:
    return target.with_name(f"{_OLD}{target.name}")


def replace_folder(made: Path, target: Path, last: str) -> None:
    """Move a folder to a path, replacing the files of a folder that is there.

    Args:
        made: the new folder.
        target: its final path.
        last: name of the file that refers to the others and is replaced after them, so that the
            old folder is valid until then; other files of both folders may have the same name only
            if they have the same content.
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
