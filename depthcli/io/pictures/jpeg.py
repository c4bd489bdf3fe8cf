"""What stands before the pixels of a JPEG, and whether it has an end (ITU-T T.81, annex B)."""

import re
from collections.abc import Iterator

JPEG_START = b"\xff\xd8"
_END, _SCAN = 0xD9, 0xDA
_STANDALONE = frozenset(range(0xD0, 0xD8)) | {0x01}
_FILL = re.compile(rb"\xff+")
# A marker is 0xFF and a byte; 0 escapes an 0xFF of the pixels, 0xD0-0xD7 only restart them.
# Without a count of 0xFF: a long run of them would be gone through once for each of them.
_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd8\xff]")


def jpeg_segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Marker and content of each segment before the pixels, as far as they are whole markers."""
    at = len(JPEG_START)
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != _SCAN:
        if data[at + 1] == 0xFF:  # fill, however long; its last byte begins a marker
            at = _FILL.match(data, at).end() - 1  # type: ignore[union-attr]
        elif data[at + 1] in _STANDALONE:
            at += 2
        else:
            length = int.from_bytes(data[at + 2 : at + 4], "big")
            yield data[at + 1], data[at + 4 : at + 2 + length]
            at += 2 + max(2, length)


def jpeg_ends(data: bytes) -> bool:
    """Whether the end marker is there, not counting that of a thumbnail inside a segment."""
    at = len(JPEG_START)
    while found := _MARKER.search(data, at):
        at = found.end()
        if data[at - 1] == _END:
            return True
        at += int.from_bytes(data[at : at + 2], "big")
    return False
