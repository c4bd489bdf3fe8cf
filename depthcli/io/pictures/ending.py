"""Signs that a picture file is cut off or damaged where decoders make up pixels in silence."""

import zlib

from depthcli.io.pictures.jpeg import JPEG_START, jpeg_ends
from depthcli.io.pictures.tiff import TIFF_STARTS, tiff_flaw
from depthcli.io.png.chunks import SIGNATURE, read_chunks

_ANCILLARY = 0x20  # set in the kind's first letter: decoders may do without the chunk


def flaw(data: bytes) -> str | None:
    """What is wrong with a JPEG's end, a PNG's chunks or a TIFF's strips; None if nothing is.

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
    return None


def _png_flaw(data: bytes) -> str | None:
    for kind, body, checksum in read_chunks(data):
        if not kind[0] & _ANCILLARY and zlib.crc32(body, zlib.crc32(kind)) != checksum:
            return "is damaged (a checksum of the PNG is wrong); copy it again"
        if kind == b"IEND":
            return None
    return "is truncated (the PNG has no end); copy it again"
