"""The frames that are done."""

import resource
from pathlib import Path

import pytest

from depthcli.video.frame_journal import FrameJournal


def test_a_full_disk_is_told_once(tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        with pytest.raises(RuntimeError), FrameJournal(tmp_path, "a", "origin") as journal:
            journal.add(1)
            resource.setrlimit(resource.RLIMIT_FSIZE, (1, before[1]))  # the disk is full
            with pytest.raises(OSError, match="File too large"):
                journal.add(2)
            raise RuntimeError  # as whoever adds tells it
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
