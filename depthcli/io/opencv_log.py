"""What OpenCV says about damaged files, which its user hears from us in one line."""

from collections.abc import Iterator
from contextlib import contextmanager

import cv2

SILENT, WARNINGS = 0, 3


def set_log_level(level: int) -> int:
    """Let OpenCV print what is as urgent as a level, in all threads; gives the level before."""
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
