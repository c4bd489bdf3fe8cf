"""The boxes of which AVIF and HEIF files consist (ISO/IEC 14496-12)."""

import struct
from collections.abc import Iterator

_HEADER_BYTES = 8  # of a box, before its content
_LONG_HEADER_BYTES = 16  # of one whose size takes 64 bits, as of some cameras' pixels


def find_box(data: bytes, wanted: bytes) -> bytes:
    """Content of the first box of a kind; empty if there is none."""
    at = 0
    while at + _HEADER_BYTES <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        header = _HEADER_BYTES
        if length == 1 and at + _LONG_HEADER_BYTES <= len(data):
            header, (length,) = _LONG_HEADER_BYTES, struct.unpack_from(">Q", data, at + header)
        if kind == wanted:
            return data[at + header : at + length]
        if length < header:
            break
        at += length
    return b""


def item_locations(iloc: bytes) -> Iterator[tuple[bool, list[tuple[int, int]]]]:
    """Of each item: whether it is in the ``idat`` box, and its (offset, length) in bytes.

    Raises:
        struct.error: the content of the ``iloc`` box is cut short.
    """
    at = 0

    def read(size: int) -> int:
        nonlocal at
        if at + size > len(iloc):
            raise struct.error("iloc is cut short")
        at += size
        return int.from_bytes(iloc[at - size : at], "big")

    version, _ = read(1), read(3)
    sizes = read(2)
    offset, length, base, index = (sizes >> shift & 15 for shift in (12, 8, 4, 0))
    wide = 2 if version < 2 else 4
    for _ in range(read(wide)):
        read(wide)
        method = read(2) & 15 if version else 0
        read(2)
        start, extents = read(base), []
        for _ in range(read(2)):
            read(index if version else 0)
            extents.append((start + read(offset), read(length)))
        yield method == 1, extents
