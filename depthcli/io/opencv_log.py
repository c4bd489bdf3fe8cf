"""OpenCV's log level: messages about damaged files are replaced by depthcli's own."""

from collections.abc import Iterator
from contextlib import contextmanager

import cv2

SILENT, WARNINGS = 0, 3


def set_log_level(level: int) -> int:
    """Set OpenCV's log level, for all threads; return the level before."""
    log = getattr(cv2.utils, "logging", cv2)  # OpenCV 4 has these in cv2 itself
    before: int = log.getLogLevel()
    log.setLogLevel(level)
    return before


@contextmanager
def silent_opencv() -> Iterator[None]:
    """Keep OpenCV silent, in all threads at once."""
    level = set_log_level(SILENT)
    try:
        yield
    finally:
        set_log_level(level)
