"""Size of a picture from its header, to refuse decompression bombs before decoding."""

import re
import struct

from depthcli.io.pictures.avif import avif_size
from depthcli.io.pictures.heif import heif_size, is_heif
from depthcli.io.pictures.jpeg import JPEG_START, jpeg_segments
from depthcli.io.pictures.tiff import TIFF_STARTS, tiff_size
from depthcli.io.png.chunks import SIGNATURE

_JPEG_SIZES = frozenset(b"\xc0\xc1\xc2\xc3\xc5\xc6\xc7\xc9\xca\xcb\xcd\xce\xcf")
_NUMBER = rb"\s+(?:#[^\n]*\n\s*)*(\d{1,9})"
NETPBM = re.compile(rb"P[1-6]" + 2 * _NUMBER + rb"(?:" + _NUMBER + rb")?\s")
"""Width, height and, except for bitmaps, the maximum value."""


def picture_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) that a file of a known picture format states; None for other files."""
    try:
        return _size_of_kind(data)
    except (struct.error, IndexError):
        return None


def _size_of_kind(data: bytes) -> tuple[int, int] | None:
    if data.startswith(SIGNATURE):
        return struct.unpack_from(">II", data, 16)
    if data.startswith(JPEG_START):
        frame = next((body for marker, body in jpeg_segments(data) if marker in _JPEG_SIZES), b"")
        height, width = struct.unpack_from(">HH", frame, 1)
        return width, height
    if data.startswith(b"BM"):
        width, height = struct.unpack_from("<HH" if is_os2(data) else "<ii", data, 18)
        return width, abs(height)
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return _webp(data)
    if data.startswith(TIFF_STARTS):
        return tiff_size(data)
    if data[4:8] == b"ftyp":
        return heif_size(data) if is_heif(data) else avif_size(data)
    if data.startswith((b"GIF87a", b"GIF89a")):
        return struct.unpack_from("<HH", data, 6)
    netpbm = NETPBM.match(data)
    return (int(netpbm[1]), int(netpbm[2])) if netpbm else None


def is_os2(data: bytes) -> bool:
    """Whether it is a BMP with the header of OS/2."""
    return data.startswith(b"BM") and data[14:18] == b"\x0c\0\0\0"


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
