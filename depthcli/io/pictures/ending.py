"""Signs that a picture file is cut off or damaged where decoders make up pixels in silence."""

from __future__ import annotations

import re
import struct
import zlib

from depthcli.io.pictures.tiff import TIFF_STARTS, tiff_flaw

_JPEG = b"\xff\xd8"
_JPEG_END = 0xD9
# A marker is 0xFF and a byte; 0 escapes an 0xFF of the pixels, 0xD0-0xD7 only restart them.
# Without a count of 0xFF: a long run of them would be gone through once for each of them.
_JPEG_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd8\xff]")

_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_FRAME = 12  # length, kind and checksum of a chunk
_ANCILLARY = 0x20  # set in the kind's first letter: decoders may do without the chunk


def flaw(data: bytes) -> str | None:
    """What is wrong with a JPEG's end, a PNG's chunks or a TIFF's strips; None if nothing is.

    The other formats' decoders find this out themselves.

    Args:
        data: the whole file.
    """
    if data.startswith(_JPEG):
        return None if _jpeg_ends(data) else "is truncated (the JPEG has no end); copy it again"
    if data.startswith(_PNG):
        return _png_flaw(data)
    if data.startswith(TIFF_STARTS):
        return tiff_flaw(data)
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
