"""Keeping OpenCV's FFmpeg from writing to standard error."""

from __future__ import annotations

import os
from contextlib import contextmanager
from typing import TYPE_CHECKING

import cv2

if TYPE_CHECKING:
    from collections.abc import Iterator

_LEVEL = "OPENCV_FFMPEG_LOGLEVEL"
_QUIET = "-8"


@contextmanager
def silent_ffmpeg() -> Iterator[None]:
    """No lines of FFmpeg's and OpenCV's own about a file; its user gets one, from us.

    FFmpeg's level is read from the environment when the first video of the process is opened, and
    stays; a level that the user set is left alone.
    """
    log = cv2.utils.logging
    level = log.getLogLevel()
    ours = _LEVEL not in os.environ
    if ours:
        os.environ[_LEVEL] = _QUIET
    log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        log.setLogLevel(level)
        if ours:
            os.environ.pop(_LEVEL, None)
