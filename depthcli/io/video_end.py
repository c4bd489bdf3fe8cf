"""Whether a video file is as long as it says."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from depthcli.io.ebml import element_at
from depthcli.io.mp4_edits import shows_every_frame

if TYPE_CHECKING:
    from pathlib import Path
    from typing import BinaryIO

_EBML = b"\x1aE\xdf\xa3"
_MP4_STARTS = {b"ftyp", b"moov", b"mdat", b"free", b"wide", b"skip"}


def is_cut(path: Path) -> bool:
    """Whether the end of a file is missing, by what MP4, MOV, Matroska, WebM or AVI state.

    Other containers state nothing and are never cut.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(12)
        end = file.seek(0, os.SEEK_END)
        if head.startswith(_EBML):
            return _matroska_end(file, end) > end
        if head[4:8] in _MP4_STARTS:
            return _mp4_end(file, end) > end
        if head.startswith(b"RIFF"):
            return int.from_bytes(head[4:8], "little") + 8 > end
    return False


def counts_frames(path: Path) -> bool:
    """Whether a file states how many frames it shows, so that missing ones can be noticed.

    AVI does, and so do MP4 and MOV unless an edit hides some or they come in fragments. Of other
    files, the number that OpenCV gives is a guess from their length.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(12)
        if head.startswith(b"RIFF"):
            return True
        return head[4:8] in _MP4_STARTS and shows_every_frame(file)


def _matroska_end(file: BinaryIO, end: int) -> int:
    try:
        segment = element_at(file, element_at(file, 0).end)
    except ValueError:
        return end + 1
    return end if segment.size is None else segment.end


def _mp4_end(file: BinaryIO, end: int) -> int:
    """Where the last box ends."""
    at = 0
    while at < end:
        file.seek(at)
        head = file.read(16)
        if len(head) < 8:  # noqa: PLR2004
            return end + 1
        size = int.from_bytes(head[:4])
        if size == 0:  # up to the end of the file, wherever that is
            return end
        at += max(8, int.from_bytes(head[8:]) if size == 1 else size)
    return at
