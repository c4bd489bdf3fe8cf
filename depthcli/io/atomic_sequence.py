"""Numbered files that appear together or not at all."""

from __future__ import annotations

import os
import shutil
from contextlib import contextmanager
from typing import TYPE_CHECKING

from depthcli.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path


@contextmanager
def atomic_sequence(folder: Path, *, inputs: Iterable[Path] = ()) -> Iterator[Path]:
    """A temporary folder whose files move into a folder when the block succeeds.

    Files of the same name are replaced, others in the folder stay.

    Args:
        folder: the files' folder; made if missing.
        inputs: files that must not be replaced.

    Yields:
        Where to write the files, under their final names.

    Raises:
        OutputError: a folder cannot be made, a file cannot be moved, or an input is in its place.
            Nothing is left behind.
    """
    temporary = folder / f".depthcli-{os.urandom(8).hex()}"
    try:
        temporary.mkdir(parents=True)
        yield temporary
        names = sorted(path.name for path in temporary.iterdir())
        for name in names:
            _check(folder / name, inputs)
        for name in names:
            os.replace(temporary / name, folder / name)  # noqa: PTH105 - as in atomic.py
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"cannot write into {folder}: {reason}; choose another --out") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _check(path: Path, inputs: Iterable[Path]) -> None:
    if path.exists() and any(path.samefile(source) for source in inputs if source.exists()):
        raise OutputError(f"{path} is an input and is not overwritten; choose another --out")
