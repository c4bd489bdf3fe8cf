"""Keeping OpenCV's FFmpeg from writing to standard error."""

from __future__ import annotations

import os
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

import cv2

if TYPE_CHECKING:
    from collections.abc import Iterator

_LEVEL = "OPENCV_FFMPEG_LOGLEVEL"
_QUIET = "-8"


@contextmanager
def silent_ffmpeg() -> Iterator[None]:
    """No lines of FFmpeg's and OpenCV's own about a file; its user gets one, from us.

    A level that the user set for FFmpeg is left alone.
    """
    log = cv2.utils.logging
    level = log.getLogLevel()
    log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        _hush()
        yield
    finally:
        log.setLogLevel(level)


@cache
def _hush() -> None:
    """Have FFmpeg's level read, which happens when a process first opens a video, and stays."""
    if _LEVEL in os.environ:
        return
    os.environ[_LEVEL] = _QUIET
    try:
        cv2.VideoCapture(os.devnull, cv2.CAP_FFMPEG).release()
    finally:
        os.environ.pop(_LEVEL, None)
