"""Detecting truncated or damaged picture files that decoders fill in without an error."""

import struct
import zlib

from depthcli.io.pictures.heif import heif_problem, is_heif
from depthcli.io.pictures.jpeg import JPEG_START, has_jpeg_end
from depthcli.io.pictures.tiff import TIFF_STARTS, tiff_problem
from depthcli.io.png.chunks import SIGNATURE, read_chunks

_ANCILLARY = 0x20  # set in the kind's first letter: decoders may do without the chunk
_BMP_HEAD, _BMP_CORE = 14, 12  # bytes: before the header proper, and of that of OS/2
_BMP_BGR = struct.pack("<III", 0xFF0000, 0xFF00, 0xFF)


def find_problem(data: bytes) -> str | None:
    """A problem of a JPEG's or HEIF's end, a PNG's chunks, a TIFF or a BMP; None without one.

    The decoders of other formats report damage themselves.

    Args:
        data: the whole file.
    """
    if data.startswith(JPEG_START):
        return None if has_jpeg_end(data) else "is truncated (its end is missing); copy it again"
    if data.startswith(SIGNATURE):
        return _png_problem(data)
    if data.startswith(TIFF_STARTS):
        return tiff_problem(data)
    if is_heif(data):
        return heif_problem(data)
    return _bmp_problem(data) if data.startswith(b"BM") else None


def _bmp_problem(data: bytes) -> str | None:
    """OpenCV would read pixels from the header, and assumes the usual order of 32-bit channels."""
    start, size = struct.unpack_from("<II", data, 10)
    if start < _BMP_HEAD + size:
        return "is damaged (the pixels of the BMP begin within its header); save it again"
    bits, coding = struct.unpack("<HI", data[28:34].ljust(6, b"\0"))
    if size > _BMP_CORE and (bits, coding) == (32, 3) and data[54:66] != _BMP_BGR:
        return "has an unusual order of colours in a BMP of 32 bits; save it as PNG"
    return None


def _png_problem(data: bytes) -> str | None:
    for kind, body, checksum in read_chunks(data):
        if not kind[0] & _ANCILLARY and zlib.crc32(body, zlib.crc32(kind)) != checksum:
            return "is damaged (a checksum of the PNG is wrong); copy it again"
        if kind == b"IEND":
            return None
    return "is truncated (its end is missing); copy it again"
