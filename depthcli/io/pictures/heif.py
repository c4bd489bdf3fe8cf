"""What the boxes of a HEIF file, such as HEIC, state about it."""

import re
import struct
from collections.abc import Iterator
from contextlib import suppress

from depthcli.io.pictures.boxes import find_box, item_locations
from depthcli.io.pictures.tiff import TIFF_STARTS

_HEVC_BRANDS = frozenset((b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs"))
_AVIF_BRANDS = frozenset((b"avif", b"avis"))
_MAX_BRANDS_BYTES = 256
_ISPE = re.compile(rb"ispe")


def is_heif(data: bytes) -> bool:
    """Whether a file is HEIF coded in HEVC; AVIF, which has the same boxes, is not."""
    if data[4:8] != b"ftyp":
        return False
    found = find_box(data, b"ftyp")[:_MAX_BRANDS_BYTES]
    brands = {found[at : at + 4] for at in range(0, len(found), 4)}
    if brands & _AVIF_BRANDS:
        return False
    return bool(brands & _HEVC_BRANDS) or (b"mif1" in brands and b"hvcC" in find_box(data, b"meta"))


def heif_size(data: bytes) -> tuple[int, int] | None:
    """The largest (width, height) that is stated of a picture, tile or thumbnail in a file.

    libheif decodes no larger ones, whatever their data states.

    Raises:
        struct.error: the file is too short for what it claims.
    """
    meta = find_box(data, b"meta")
    sizes = [struct.unpack_from(">II", meta, found.end() + 4) for found in _ISPE.finditer(meta)]
    return max(sizes, key=lambda size: size[0] * size[1], default=None)


def heif_problem(data: bytes) -> str | None:
    """The problem of a file that ends before its items do; None without one.

    libheif leaves tiles that are missing black, without an error.
    """
    try:
        for whole, extents in _items(data):
            if any(at + length > len(whole) for at, length in extents):
                break
        else:
            return None
    except struct.error:
        pass
    return "is truncated (its end is missing); copy it again"


def heif_exif(data: bytes) -> bytes:
    """The TIFF structure of the EXIF of a HEIF or AVIF file; empty if none can be found."""
    with suppress(struct.error):
        for whole, extents in _items(data):
            at, length = extents[0] if extents else (0, 0)
            item = memoryview(whole)[at : at + length]
            start = 4 + int.from_bytes(item[:4], "big")  # of EXIF: where its TIFF structure is
            if bytes(item[start : start + 4]) in TIFF_STARTS:
                return bytes(item[start:])
    return b""


def _items(data: bytes) -> Iterator[tuple[bytes, list[tuple[int, int]]]]:
    """What each item is in, and its (offset, length) there in bytes."""
    meta = find_box(data, b"meta")[4:]  # a version comes before its boxes
    inside = find_box(meta, b"idat")
    for is_inside, extents in item_locations(find_box(meta, b"iloc")):
        yield (inside if is_inside else data), extents
