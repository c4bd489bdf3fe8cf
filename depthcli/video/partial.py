"""A depth video that is not finished, kept under a hidden name until a run goes on with it."""

import hashlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from depthcli.core.ending import before_ending
from depthcli.errors import InputError
from depthcli.io.storage.lock import open_locked
from depthcli.video.depth import DepthVideo


class PartialVideo(NamedTuple):
    """Two hidden files beside an output."""

    earlier: Path  #: frames of a run that was stopped; empty or missing without one
    written: Path  #: takes all frames once more, so that stopping again loses nothing


@contextmanager
def partial_video(path: Path, fingerprint: str) -> Iterator[PartialVideo | None]:
    """Where a video's frames are until it is whole. The longer file stays if the block fails.

    Args:
        path: the output; what is there of it by another fingerprint is removed.
        fingerprint: what frames follow from.

    Yields:
        The files; None if another process has them, or the system renames no open files.

    Raises:
        OSError: the folder cannot be written to.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    start = f".depthcli-{hashlib.sha256(os.fsencode(path.name)).hexdigest()[:8]}-"
    files = [path.with_name(f"{start}{fingerprint[:16]}-{i}{path.suffix}") for i in (1, 2)]
    handle = None if sys.platform == "win32" else open_locked(files[0])
    if handle is None:
        yield None
        return
    stay: list[Path] = []
    try:
        for other in set(path.parent.glob(f"{start}*")) - set(files):
            other.unlink(missing_ok=True)
        written, earlier = sorted(files, key=_bytes_there)
        with before_ending(partial(_remove_empty, files)):
            yield PartialVideo(earlier, written)
    except BaseException:
        longer = max(files, key=_bytes_there)
        stay = [longer] if next(held_steps(longer), None) is not None else []
        raise
    finally:
        for file in set(files) - set(stay):
            file.unlink(missing_ok=True)
        os.close(handle)


def held_steps(path: Path) -> Iterator[npt.NDArray[np.uint16]]:
    """The frames of a depth video, (H, W) uint16, up to where it is cut or damaged."""
    try:
        yield from DepthVideo(path).steps()
    except InputError:
        return


def _remove_empty(files: list[Path]) -> None:
    for file in files:
        if not _bytes_there(file):
            file.unlink(missing_ok=True)


def _bytes_there(file: Path) -> int:
    return file.stat().st_size if file.exists() else 0
