"""The frames that are done."""

import resource
from contextlib import suppress
from pathlib import Path

from depthcli.jobs.video.resume import FrameJournal


def test_a_full_disk_is_told_once(tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    journal = FrameJournal(tmp_path / ".a.depthcli-frames", "origin")
    try:
        with journal, suppress(OSError):
            journal.add(1)
            resource.setrlimit(resource.RLIMIT_FSIZE, (1, before[1]))  # the disk is full
            journal.add(2)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
