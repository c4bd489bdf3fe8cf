"""The segments of a JPEG, and whether it has an end marker (ITU-T T.81, annex B)."""

import re
from collections.abc import Iterator

JPEG_START = b"\xff\xd8"
_END, _SCAN = 0xD9, 0xDA
_STANDALONE = frozenset(b"\x01\xd0\xd1\xd2\xd3\xd4\xd5\xd6\xd7")
_FILLED_MARKER = re.compile(rb"\xff+([^\xff])", re.DOTALL)  # fill, however long, and the marker
# A marker is 0xFF and a byte; 0 escapes an 0xFF of the pixels, 0xD0-0xD7 only restart them.
# Not 0xFF+: a long run of 0xFF would take quadratic time.
_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd8\xff]")


def jpeg_segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Marker and content of each segment before the pixels, up to the first invalid one."""
    at = len(JPEG_START)
    while (found := _FILLED_MARKER.match(data, at)) and found[1][0] != _SCAN:
        at = found.end()
        if found[1][0] not in _STANDALONE:
            length = int.from_bytes(data[at : at + 2], "big")
            yield found[1][0], data[at + 2 : at + length]
            at += length


def has_jpeg_end(data: bytes) -> bool:
    """Whether there is an end marker, not counting that of a thumbnail inside a segment."""
    at = len(JPEG_START)
    while found := _MARKER.search(data, at):
        at = found.end()
        if data[at - 1] == _END:
            return True
        at += int.from_bytes(data[at : at + 2], "big")
    return False
