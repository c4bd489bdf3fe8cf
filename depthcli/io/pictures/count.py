"""The number of pictures in a file, without decoding them."""

import struct

from depthcli.io.pictures.riff import riff_chunks
from depthcli.io.pictures.tiff import TIFF_STARTS, tiff_directories
from depthcli.io.png.chunks import SIGNATURE, read_chunks

_GIF_STARTS = (b"GIF87a", b"GIF89a")
_GIF_IMAGE, _GIF_EXTENSION, _GIF_TABLE = 0x2C, 0x21, 0x80


def count_warnings(data: bytes) -> tuple[str, ...]:
    """A warning about a TIFF of several pages or an animated picture; empty for others.

    Args:
        data: a whole file that can be decoded.
    """
    if data[4:12] == b"ftypavis":
        return ("is an animated AVIF; only the first picture is used",)
    count = _picture_count(data)
    return (f"has {count} pictures; only the first is used",) if count > 1 else ()


def _picture_count(data: bytes) -> int:
    count = 0
    try:
        if data.startswith(TIFF_STARTS):
            for is_picture in tiff_directories(data):
                count += is_picture or not count
        elif data.startswith(SIGNATURE):
            heads = (body for kind, body, _ in read_chunks(data) if kind == b"acTL")
            count = int.from_bytes(next(heads, b"")[:4], "big")
        elif data[:4] == b"RIFF" and data[12:16] == b"VP8X":
            count = sum(kind == b"ANMF" for kind, _ in riff_chunks(data))
        elif data.startswith(_GIF_STARTS):
            at = 13 + _gif_table_bytes(data[10])
            while data[at] in (_GIF_IMAGE, _GIF_EXTENSION):
                is_image = data[at] == _GIF_IMAGE
                count += is_image
                at += 11 + _gif_table_bytes(data[at + 9]) if is_image else 2
                while data[at]:
                    at += data[at] + 1
                at += 1
    except (struct.error, IndexError):  # decoders, too, pass over what follows the first picture
        pass
    return count


def _gif_table_bytes(flags: int) -> int:
    """Size of a colour table, by the flags before it."""
    return 6 << (flags & 7) if flags & _GIF_TABLE else 0
