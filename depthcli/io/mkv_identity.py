"""What FFmpeg draws at random or sums up in a Matroska file, made to follow from its content.

Without it no two runs would write the same bytes, and checksums would be of the content before its
times were corrected (RFC 9559, Matroska; RFC 8794, EBML).
"""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

from depthcli.io.ebml import content, elements

if TYPE_CHECKING:
    from typing import BinaryIO

    from depthcli.io.ebml import Element

_INFO, _TRACKS, _TAGS = 0x1549A966, 0x1654AE6B, 0x1254C367
_CUES, _CLUSTER = 0x1C53BB6B, 0x1F43B675
_TRACK, _TAG, _TARGETS, _SIMPLE_TAG = 0xAE, 0x7373, 0x63C0, 0x67C8
_SEGMENT_UID, _TRACK_UID, _TAG_TRACK_UID = 0x73A4, 0x73C5, 0x63C5
_TAG_NAME, _TAG_STRING, _CHECKSUM = 0x45A3, 0x4487, 0xBF
_NESTED = {_INFO, _TRACKS, _TAGS, _TRACK, _TAG, _TARGETS}
_CHANGED = {_INFO, _TRACKS, _TAGS, _CUES, _CLUSTER}
_FIRST_TRACK = 1


def identify(file: BinaryIO, segment: Element, uid: bytes, duration_s: float) -> None:
    """Replace random numbers and the length in words, then the checksums of all parts.

    Args:
        file: of one track, open for reading and writing.
        segment: all of the file behind its header.
        uid: 16 bytes that name the file.
        duration_s: its length.

    Raises:
        ValueError: the file is damaged.
    """
    for part in list(elements(file, segment.start, segment.end)):
        if part.id in _NESTED:
            _replace(file, part, uid, _words(duration_s))
        if part.id in _CHANGED:
            _seal(file, part)


def _replace(file: BinaryIO, parent: Element, uid: bytes, duration: str) -> None:
    for element in list(elements(file, parent.start, parent.end)):
        width = element.end - element.start
        if element.id in _NESTED:
            _replace(file, element, uid, duration)
        elif element.id == _SEGMENT_UID:
            _write(file, element, uid[:width].ljust(width, b"\0"))
        elif element.id in {_TRACK_UID, _TAG_TRACK_UID}:
            _write(file, element, _FIRST_TRACK.to_bytes(width))
        elif element.id == _SIMPLE_TAG:
            parts = {part.id: part for part in elements(file, element.start, element.end)}
            if _TAG_STRING in parts and content(file, parts[_TAG_NAME]) == b"DURATION":
                text = parts[_TAG_STRING]
                width = text.end - text.start
                _write(file, text, duration.encode()[:width].ljust(width, b"\0"))


def _words(duration_s: float) -> str:
    """``00:01:02.500000000``, as FFmpeg has it."""
    minutes, seconds = divmod(round(duration_s, 9), 60)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours:02}:{minutes:02}:{seconds:012.9f}"


def _seal(file: BinaryIO, part: Element) -> None:
    """Correct the checksum of a part, which comes first in it, if it has one."""
    first = next(elements(file, part.start, part.end), None)
    if first is None or first.id != _CHECKSUM:
        return
    file.seek(first.end)
    checksum = zlib.crc32(file.read(part.end - first.end))
    _write(file, first, checksum.to_bytes(first.end - first.start, "little"))


def _write(file: BinaryIO, element: Element, data: bytes) -> None:
    file.seek(element.start)
    file.write(data)
