"""Incomplete depth videos, kept under hidden names until a run resumes them."""

import hashlib
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from depthcli.core.exit_hooks import exit_hook
from depthcli.errors import InputError
from depthcli.io.storage.lock import open_locked
from depthcli.video.depth import DepthVideo


class PartialVideo(NamedTuple):
    """Two hidden files beside an output."""

    earlier: Path  #: frames of an interrupted run; empty or missing if there is none
    written: Path  #: the file being written, with all frames, so that no interruption loses any


@contextmanager
def partial_video(path: Path, fingerprint: str) -> Iterator[PartialVideo | None]:
    """The files of an incomplete video. The longer one is kept if the block fails.

    Args:
        path: the output; its files with other fingerprints are removed.
        fingerprint: of everything that the frames depend on.

    Yields:
        The files; None if another process has locked them, or open files cannot be renamed.

    Raises:
        OSError: the folder cannot be written to.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    start = _name_start(path)
    files = [path.with_name(f"{start}{fingerprint[:16]}-{i}{path.suffix}") for i in (1, 2)]
    handle = None if sys.platform == "win32" else open_locked(files[0])
    if handle is None:
        yield None
        return
    kept: list[Path] = []
    try:
        remove_partial_videos(path, keep=files)
        written, earlier = sorted(files, key=_size_of)
        with exit_hook(partial(_remove_empty, files)):
            yield PartialVideo(earlier, written)
    except BaseException:
        longer = max(files, key=_size_of)
        kept = [longer] if next(readable_steps(longer), None) is not None else []
        raise
    finally:
        for file in set(files) - set(kept):
            file.unlink(missing_ok=True)
        os.close(handle)


def remove_partial_videos(path: Path, keep: Iterable[Path] = ()) -> None:
    """Remove the unfinished files of an output that is going to be replaced.

    Raises:
        OSError: the folder cannot be written to.
    """
    for file in set(path.parent.glob(f"{_name_start(path)}*")).difference(keep):
        file.unlink(missing_ok=True)


def readable_steps(path: Path) -> Iterator[npt.NDArray[np.uint16]]:
    """The frames of a depth video, (H, W) uint16, up to where it is truncated or damaged."""
    try:
        yield from DepthVideo(path).steps()
    except InputError:
        return


def _name_start(path: Path) -> str:
    """What the names of an output's unfinished files begin with."""
    return f".depthcli-{hashlib.sha256(os.fsencode(path.name)).hexdigest()[:8]}-"


def _remove_empty(files: list[Path]) -> None:
    for file in files:
        if not _size_of(file):
            file.unlink(missing_ok=True)


def _size_of(file: Path) -> int:
    return file.stat().st_size if file.exists() else 0
