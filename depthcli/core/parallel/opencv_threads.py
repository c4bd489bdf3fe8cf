"""Limiting OpenCV's own threads where each worker thread processes a whole picture."""

from collections.abc import Iterator
from contextlib import contextmanager

import cv2


@contextmanager
def one_thread_each(workers: int) -> Iterator[None]:
    """Let OpenCV use the calling thread alone while there are two workers or more."""
    threads = cv2.getNumThreads()
    if workers > 1:
        cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
