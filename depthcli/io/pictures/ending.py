"""Signs that a picture file is cut off or damaged where decoders make up pixels in silence."""

import struct
import zlib

from depthcli.io.pictures.jpeg import JPEG_START, jpeg_ends
from depthcli.io.pictures.tiff import TIFF_STARTS, tiff_flaw
from depthcli.io.png.chunks import SIGNATURE, read_chunks

_ANCILLARY = 0x20  # set in the kind's first letter: decoders may do without the chunk
_BMP_HEAD, _BMP_CORE = 14, 12  # bytes: before the header proper, and of that of OS/2
_BMP_BGR = struct.pack("<III", 0xFF0000, 0xFF00, 0xFF)


def flaw(data: bytes) -> str | None:
    """What is wrong with a JPEG's end, a PNG's chunks, a TIFF or BMP; None if nothing is.

    The other formats' decoders find this out themselves.

    Args:
        data: the whole file.
    """
    if data.startswith(JPEG_START):
        return None if jpeg_ends(data) else "is truncated (the JPEG has no end); copy it again"
    if data.startswith(SIGNATURE):
        return _png_flaw(data)
    if data.startswith(TIFF_STARTS):
        return tiff_flaw(data)
    return _bmp_flaw(data) if data.startswith(b"BM") else None


def _bmp_flaw(data: bytes) -> str | None:
    """OpenCV reads pixels out of the header, and 32 bits a pixel in the usual order alone."""
    start, size = struct.unpack_from("<II", data, 10)
    if start < _BMP_HEAD + size:
        return "is damaged (the pixels of the BMP begin within its header); save it again"
    bits, coding = struct.unpack("<HI", data[28:34].ljust(6, b"\0"))
    if size > _BMP_CORE and (bits, coding) == (32, 3) and data[54:66] != _BMP_BGR:
        return "has an unusual order of colours in a BMP of 32 bits; save it as PNG"
    return None


def _png_flaw(data: bytes) -> str | None:
    for kind, body, checksum in read_chunks(data):
        if not kind[0] & _ANCILLARY and zlib.crc32(body, zlib.crc32(kind)) != checksum:
            return "is damaged (a checksum of the PNG is wrong); copy it again"
        if kind == b"IEND":
            return None
    return "is truncated (the PNG has no end); copy it again"
