"""Signs that a picture file is cut off or damaged where decoders make up pixels in silence."""

from __future__ import annotations

import re
import struct
import zlib

from depthcli.io.pictures.tiff import COMPRESSION, TIFF_STARTS, tiff_tags

_JPEG = b"\xff\xd8"
_JPEG_END = 0xD9
# A marker is 0xFF and a byte; 0 escapes an 0xFF of the pixels, 0xD0-0xD7 only restart them.
# Without a count of 0xFF: a long run of them would be gone through once for each of them.
_JPEG_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd8\xff]")

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_FRAME = 12  # length, kind and checksum of a chunk
_ANCILLARY = 0x20  # set in the kind's first letter: decoders may do without the chunk

# Of any other, OpenCV makes a black picture.
_TIFF_CODINGS = frozenset({1, 2, 3, 4, 5, 6, 7, 8, 32773, 32946, 34676, 34677, 34887, 34925})
_TIFF_CODINGS |= {50000, 50001}


def flaw(data: bytes) -> str | None:
    """What is wrong with a JPEG's end, a PNG's chunks or a TIFF's coding; None if nothing is.

    The other formats' decoders find this out themselves.

    Args:
        data: the whole file.
    """
    if data.startswith(_JPEG):
        return None if _jpeg_ends(data) else "is truncated (the JPEG has no end); copy it again"
    if data.startswith(_PNG):
        return _png_flaw(data)
    if data.startswith(TIFF_STARTS):
        try:
            coding = tiff_tags(data, (COMPRESSION,)).get(COMPRESSION, 1)
        except struct.error:
            return "is truncated (the TIFF's directory has no end); copy it again"
        if coding not in _TIFF_CODINGS:
            return f"has the unknown TIFF compression {coding}; save it without one"
    return None


def _jpeg_ends(data: bytes) -> bool:
    """Whether the end marker is there, not counting that of a thumbnail inside a segment."""
    at = len(_JPEG)
    while found := _JPEG_MARKER.search(data, at):
        at = found.end()
        if data[at - 1] == _JPEG_END:
            return True
        at += int.from_bytes(data[at : at + 2], "big")
    return False


def _png_flaw(data: bytes) -> str | None:
    view, at = memoryview(data), len(_PNG)
    while at + _PNG_FRAME <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + _PNG_FRAME + length
        if end > len(data):
            break
        (checksum,) = struct.unpack_from(">I", data, end - 4)
        if not kind[0] & _ANCILLARY and zlib.crc32(view[at + 4 : end - 4]) != checksum:
            return "is damaged (a checksum of the PNG is wrong); copy it again"
        if kind == b"IEND":
            return None
        at = end
    return "is truncated (the PNG has no end); copy it again"
