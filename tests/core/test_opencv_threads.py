"""OpenCV's threads while several workers share the work."""

import cv2
import pytest

from depthcli.core.parallel import one_thread_each


@pytest.mark.parametrize(("workers", "inside"), [(0, 3), (1, 3), (2, 1)])
def test_opencv_keeps_its_threads_unless_workers_need_them(workers: int, inside: int) -> None:
    before = cv2.getNumThreads()
    cv2.setNumThreads(3)
    try:
        with one_thread_each(workers):
            assert cv2.getNumThreads() == inside
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(before)
