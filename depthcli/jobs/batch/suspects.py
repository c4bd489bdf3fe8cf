"""Inputs that may have ended the process of an earlier batch, decoded in one of their own first.

A decoder that crashes takes the whole process along, and no row is left of its input. It is among
the first inputs without a row, as workers begin them in their order.
"""

import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from depthcli.errors import InputError
from depthcli.io.manifest.journal import Rows
from depthcli.io.manifest.row import Row
from depthcli.io.writers.formats import Format
from depthcli.jobs.batch.task import Task
from depthcli.video.formats import VideoFormat

_Which = TypeVar("_Which", Format, VideoFormat)
_ENDS = "ends the process that decodes it"
_PICTURE = """
import sys
from depthcli.io.pictures.read import read_image
read_image(None, sys.stdin.buffer.read())
"""
_VIDEO = """
import sys
from depthcli.video.source import VideoSource
for _ in VideoSource(sys.argv[1]).frames(): pass
"""
_CRASHES = {
    -getattr(signal, name)
    for name in ("SIGABRT", "SIGBUS", "SIGFPE", "SIGILL", "SIGKILL", "SIGSEGV")
    if hasattr(signal, name)
}


def suspected(tasks: Iterable[Task[_Which]], rows: Rows, count: int) -> Iterator[Task[_Which]]:
    """The tasks, the first so many without a row as suspects."""
    for task in tasks:
        if count and rows.row(task.input.name) is None:
            count -= 1
            yield replace(task, is_suspect=True)
        else:
            yield task


def has_crashed(row: Row | None) -> bool:
    """Whether an input was found out; it is tried again, as another decoder may read it."""
    return row is not None and _ENDS in (row.error or "")


def check_picture(name: str, data: bytes) -> None:
    """Decode a picture in a process of its own.

    Raises:
        InputError: the process crashed; whatever else is wrong is for the caller to find.
    """
    _decode_apart(name, [_PICTURE], data)


def check_video(name: str, path: Path) -> None:
    """Decode a video in a process of its own, as :func:`check_picture` does."""
    _decode_apart(name, [_VIDEO, str(path)], b"")


def _decode_apart(name: str, words: list[str], data: bytes) -> None:
    command = [sys.executable, "-P", "-c", *words]
    done = subprocess.run(command, input=data, capture_output=True, check=False)  # noqa: S603 - our own
    if done.returncode in _CRASHES:
        by = signal.Signals(-done.returncode).name
        raise InputError(f"{name} {_ENDS} ({by}); save it again with another program")
