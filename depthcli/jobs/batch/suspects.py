"""Inputs that may have crashed an earlier batch; they are decoded in a subprocess first.

A decoder that crashes ends the whole process, and its input gets no row. That input is among the
first ones without a row, as workers start inputs in order.
"""

import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from depthcli.errors import InputError
from depthcli.io.formats.table import Format
from depthcli.io.manifest.journal import Rows
from depthcli.io.manifest.row import Row
from depthcli.jobs.batch.task import Task
from depthcli.video.formats import VideoFormat

_FormatT = TypeVar("_FormatT", Format, VideoFormat)
_CRASH_TEXT = "ends the process that decodes it"
_DECODE_PICTURE = """
import sys
from depthcli.io.images.read import read_image
read_image(None, sys.stdin.buffer.read())
"""
_DECODE_VIDEO = """
import sys
from depthcli.video.source import VideoSource
for _ in VideoSource(sys.argv[1]).frames(): pass
"""
_CRASH_SIGNALS = {
    -getattr(signal, name)
    for name in ("SIGABRT", "SIGBUS", "SIGFPE", "SIGILL", "SIGKILL", "SIGSEGV")
    if hasattr(signal, name)
}


def mark_suspects(
    tasks: Iterable[Task[_FormatT]], rows: Rows, count: int
) -> Iterator[Task[_FormatT]]:
    """The tasks, with the first ``count`` of those without a row marked as suspects."""
    for task in tasks:
        if count and rows.row(task.input.name) is None:
            count -= 1
            yield replace(task, is_suspect=True)
        else:
            yield task


def has_crashed(row: Row | None) -> bool:
    """Whether the row says that decoding crashed; a later run may have another decoder."""
    return row is not None and _CRASH_TEXT in (row.error or "")


def check_picture(name: str, data: bytes) -> None:
    """Decode a picture in a subprocess.

    Raises:
        InputError: the subprocess crashed; other errors are left to the caller's own decoding.
    """
    _decode_in_subprocess(name, [_DECODE_PICTURE], data)


def check_video(name: str, path: Path) -> None:
    """Decode a video in a subprocess, as :func:`check_picture` does."""
    _decode_in_subprocess(name, [_DECODE_VIDEO, str(path)], b"")


def _decode_in_subprocess(name: str, arguments: list[str], data: bytes) -> None:
    command = [sys.executable, "-P", "-c", *arguments]
    done = subprocess.run(command, input=data, capture_output=True, check=False)  # noqa: S603 - our own
    if done.returncode in _CRASH_SIGNALS:
        by = signal.Signals(-done.returncode).name
        raise InputError(f"{name} {_CRASH_TEXT} ({by}); save it again with another program")
