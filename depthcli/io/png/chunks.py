"""What a PNG file is made of (PNG specification, third edition, chapter 5)."""

import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress

SIGNATURE = b"\x89PNG\r\n\x1a\n"
MAX_LENGTH = 2**31 - 1
"""Most bytes of a chunk, and most columns or rows of a picture."""
_ANIMATION = (b"acTL", b"fcTL", b"fdAT")


def chunk(kind: bytes, body: bytes | bytearray | memoryview) -> tuple[bytes | memoryview, ...]:
    """The parts of one chunk of four letters, for the caller to join with all others in one copy.

    The body has at most ``MAX_LENGTH`` bytes.
    """
    check = zlib.crc32(body, zlib.crc32(kind))
    return struct.pack(">I4s", len(body), kind), memoryview(body), struct.pack(">I", check)


def read_chunks(png: bytes) -> Iterator[tuple[bytes, memoryview, int]]:
    """Kind, body and checksum of each chunk, up to the first that is not whole."""
    view, at = memoryview(png), len(SIGNATURE)
    with suppress(struct.error):
        while True:
            length, kind = struct.unpack_from(">I4s", png, at)
            (checksum,) = struct.unpack_from(">I", png, at + 8 + length)
            yield kind, view[at + 8 : at + 8 + length], checksum
            at += 12 + length


def still(png: bytes) -> bytes:
    """An animated PNG as its still picture, which OpenCV does not read where a frame has its place.

    All other bytes are returned as they are.
    """
    if not png.startswith(SIGNATURE) or b"acTL" not in png:
        return png
    chunks = (chunk(kind, body) for kind, body, _ in read_chunks(png) if kind not in _ANIMATION)
    return b"".join((SIGNATURE, *(part for parts in chunks for part in parts)))
