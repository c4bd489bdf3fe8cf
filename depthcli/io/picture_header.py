"""Size of a picture from its first bytes, so that a bomb is refused before it is decoded."""

from __future__ import annotations

import struct

_JPEG_SIZES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_STANDALONE = frozenset(range(0xD0, 0xD8)) | {0x01}


def picture_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) that a JPEG, PNG, BMP, WebP, TIFF or AVIF claims; None if it is not found.

    Args:
        data: the whole file.
    """
    try:
        return _size(data)
    except (struct.error, IndexError):
        return None


def truncation(data: bytes) -> str | None:
    """What shows that a JPEG or PNG ends too early; None if nothing does.

    Decoders fill the missing part with gray and say nothing.
    """
    if data[:2] == b"\xff\xd8" and b"\xff\xd9" not in data[-65536:]:
        return "the end marker of the JPEG is missing"
    if data[:8] == b"\x89PNG\r\n\x1a\n" and b"IEND" not in data[-65536:]:
        return "the end chunk of the PNG is missing"
    return None


def _size(data: bytes) -> tuple[int, int] | None:
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        return struct.unpack_from(">II", data, 16)
    if data[:2] == b"\xff\xd8":
        return _jpeg(data)
    if data[:2] == b"BM":
        width, height = struct.unpack_from("<ii", data, 18)
        return width, abs(height)
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return _webp(data)
    if data[:4] in (b"II*\0", b"MM\0*"):
        return _tiff(data)
    if data[4:8] == b"ftyp":
        at = data.find(b"ispe")
        return struct.unpack_from(">II", data, at + 8) if at >= 0 else None
    return None


def _jpeg(data: bytes) -> tuple[int, int] | None:
    at = 2
    while at + 9 <= len(data):
        if data[at] != 0xFF:
            return None
        marker = data[at + 1]
        if marker in _JPEG_SIZES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        fill = marker == 0xFF
        skipped = 1 if fill else 2
        if not fill and marker not in _STANDALONE:
            skipped += struct.unpack_from(">H", data, at + 2)[0]
        at += skipped
    return None


def _webp(data: bytes) -> tuple[int, int] | None:
    kind = data[12:16]
    if kind == b"VP8X":
        width = int.from_bytes(data[24:27], "little") + 1
        return width, int.from_bytes(data[27:30], "little") + 1
    if kind == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    return None


def _tiff(data: bytes) -> tuple[int, int] | None:
    order = "<" if data[:2] == b"II" else ">"
    (at,) = struct.unpack_from(order + "I", data, 4)
    (count,) = struct.unpack_from(order + "H", data, at)
    found = {}
    for entry in range(at + 2, at + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(order + "HH", data, entry)
        form = "H" if kind == 3 else "I"  # SHORT
        (found[tag],) = struct.unpack_from(order + form, data, entry + 8)
    return (found[256], found[257]) if {256, 257} <= found.keys() else None
