"""What stands before the pixels of a JPEG, and whether it has an end (ITU-T T.81, annex B)."""

import re
from collections.abc import Iterator

JPEG_START = b"\xff\xd8"
_END, _SCAN = 0xD9, 0xDA
_STANDALONE = frozenset(b"\x01\xd0\xd1\xd2\xd3\xd4\xd5\xd6\xd7")
_FILLED = re.compile(rb"\xff+([^\xff])", re.DOTALL)  # fill, however long, and the marker
# A marker is 0xFF and a byte; 0 escapes an 0xFF of the pixels, 0xD0-0xD7 only restart them.
# Without a count of 0xFF: a long run of them would be gone through once for each of them.
_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd8\xff]")


def jpeg_segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Marker and content of each segment before the pixels, as far as they are whole markers."""
    at = len(JPEG_START)
    while (found := _FILLED.match(data, at)) and found[1][0] != _SCAN:
        at = found.end()
        if found[1][0] not in _STANDALONE:
            length = int.from_bytes(data[at : at + 2], "big")
            yield found[1][0], data[at + 2 : at + length]
            at += length


def jpeg_ends(data: bytes) -> bool:
    """Whether the end marker is there, not counting that of a thumbnail inside a segment."""
    at = len(JPEG_START)
    while found := _MARKER.search(data, at):
        at = found.end()
        if data[at - 1] == _END:
            return True
        at += int.from_bytes(data[at : at + 2], "big")
    return False
