"""Folders that appear whole or not at all, and those that are gone wholly or not at all."""

from __future__ import annotations

import os
import shutil
from contextlib import contextmanager
from typing import TYPE_CHECKING

from depthcli.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@contextmanager
def folder_in_place(target: Path) -> Iterator[Path]:
    """A temporary folder that takes the target's place when the block succeeds.

    Raises:
        OutputError: the folder cannot be made or replaced; what was there stays.
    """
    temporary = target.with_name(f".depthcli-{os.urandom(8).hex()}")
    try:
        temporary.mkdir(parents=True)
        yield temporary
        if target.is_symlink():
            target.unlink()
        with moved_away(target):
            temporary.rename(target)
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"cannot write {target}: {reason}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def moved_away(folder: Path) -> Iterator[None]:
    """Rename a folder, delete it if the block succeeds, else put it back."""
    if not folder.is_dir():
        yield
        return
    aside = folder.with_name(f".depthcli-{os.urandom(8).hex()}")
    folder.rename(aside)
    try:
        yield
    except BaseException:
        aside.rename(folder)
        raise
    shutil.rmtree(aside, ignore_errors=True)
