"""OpenCV's own threads, which are in the way where whole pictures are shared out among threads."""

from collections.abc import Iterator
from contextlib import contextmanager

import cv2


@contextmanager
def one_thread_each(workers: int) -> Iterator[None]:
    """Let OpenCV work in the calling thread alone while two workers or more call it."""
    threads = cv2.getNumThreads()
    if workers > 1:
        cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
