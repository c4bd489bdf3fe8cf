"""The chunks of a PNG file (PNG specification, third edition, chapter 5 and 11.3.3)."""

import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress

SIGNATURE = b"\x89PNG\r\n\x1a\n"
MAX_LENGTH = 2**31 - 1
"""Most bytes of a chunk, and most columns or rows of a picture."""
_ANIMATION = (b"acTL", b"fcTL", b"fdAT")


def chunk(kind: bytes, body: bytes | bytearray | memoryview) -> tuple[bytes | memoryview, ...]:
    """The parts of a chunk, which the caller joins with all others in one copy.

    The kind has four letters, the body at most ``MAX_LENGTH`` bytes.
    """
    check = zlib.crc32(body, zlib.crc32(kind))
    return struct.pack(">I4s", len(body), kind), memoryview(body), struct.pack(">I", check)


def read_chunks(png: bytes) -> Iterator[tuple[bytes, memoryview, int]]:
    """Kind, body and checksum of each chunk, up to the first incomplete one."""
    view, at = memoryview(png), len(SIGNATURE)
    with suppress(struct.error):
        while True:
            length, kind = struct.unpack_from(">I4s", png, at)
            (checksum,) = struct.unpack_from(">I", png, at + 8 + length)
            yield kind, view[at + 8 : at + 8 + length], checksum
            at += 12 + length


def static_image(png: bytes) -> bytes:
    """The static image of an animated PNG, which OpenCV does not always decode.

    All other files are returned unchanged.
    """
    if not png.startswith(SIGNATURE) or b"acTL" not in png:
        return png
    chunks = (chunk(kind, body) for kind, body, _ in read_chunks(png) if kind not in _ANIMATION)
    return b"".join((SIGNATURE, *(part for parts in chunks for part in parts)))


def text_chunk(keyword: str, text: str) -> tuple[bytes | memoryview, ...]:
    """The parts of a chunk that holds a text, by a keyword of 1-79 Latin-1 characters.

    A text that is not Latin-1 is stored as UTF-8.
    """
    name = keyword.encode("latin-1")
    try:
        return chunk(b"tEXt", name + b"\0" + text.encode("latin-1"))
    except UnicodeEncodeError:
        return chunk(b"iTXt", name + b"\0\0\0\0\0" + text.encode())


def read_text(png: bytes) -> dict[str, str]:
    """The tEXt and uncompressed iTXt chunks of a PNG file; damaged ones are left out."""
    texts = {}
    for kind, body, _ in read_chunks(png):
        if kind not in (b"tEXt", b"iTXt"):
            continue
        keyword, _, rest = bytes(body).partition(b"\0")
        if kind == b"tEXt":
            texts[keyword.decode("latin-1")] = rest.decode("latin-1")
        elif rest.startswith(b"\0\0"):
            text = rest[2:].split(b"\0", 2)[-1]
            texts[keyword.decode("latin-1")] = text.decode("utf-8", "replace")
    return texts
