"""Size and transfer function of an AVIF's pictures, by boxes and AV1 sequence headers (5.5.1)."""

import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice

from depthcli.io.images.tiff import TIFF_STARTS

_HEADER_BYTES = 8  # of a box, before its content
_LONG_HEADER_BYTES = 16  # of one whose size takes 64 bits, as of some cameras' pixels


def find_box(data: bytes, wanted: bytes) -> bytes:
    """Content of the first box of a kind; empty if there is none."""
    at = 0
    while at + _HEADER_BYTES <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        header = _HEADER_BYTES
        if length == 1 and at + _LONG_HEADER_BYTES <= len(data):
            header, (length,) = _LONG_HEADER_BYTES, struct.unpack_from(">Q", data, at + header)
        if kind == wanted:
            return data[at + header : at + length]
        if length < header:
            break
        at += length
    return b""


def item_locations(iloc: bytes) -> Iterator[tuple[bool, list[tuple[int, int]]]]:
    """Of each item: whether it is in the ``idat`` box, and its (offset, length) in bytes.

    Raises:
        struct.error: the content of the ``iloc`` box is cut short.
    """
    at = 0

    def read(size: int) -> int:
        nonlocal at
        if at + size > len(iloc):
            raise struct.error("iloc is cut short")
        at += size
        return int.from_bytes(iloc[at - size : at], "big")

    version, _ = read(1), read(3)
    sizes = read(2)
    offset, length, base, index = (sizes >> shift & 15 for shift in (12, 8, 4, 0))
    wide = 2 if version < 2 else 4
    for _ in range(read(wide)):
        read(wide)
        method = read(2) & 15 if version else 0
        read(2)
        start, extents = read(base), []
        for _ in range(read(2)):
            read(index if version else 0)
            extents.append((start + read(offset), read(length)))
        yield method == 1, extents


_ISPE = re.compile(rb"ispe")
_NCLX = re.compile(rb"colrnclx..(..)", re.DOTALL)
_STCO = re.compile(rb"stco\0\0\0\0")
_SEQUENCE_HEADER = 1
_MAX_OBUS = 10_000
_MAX_TRACKS = 16
_MAX_OVERLAP = 4  # items may use the same bytes, but not all of them all the time
_SEQUENCE_HEADER_BYTES = 1024  # more than the fields before the size can take


def avif_size(data: bytes) -> tuple[int, int] | None:
    """The largest (width, height) of a file's items, tiles and thumbnails among them.

    A decoder allocates memory for the size in the AV1 data, whatever the boxes state.

    Raises:
        struct.error: the file is too short for what it claims.
        IndexError: likewise.
    """
    claims = data[: data.find(b"mdat")]
    starts = [found.end() + 4 for found in _ISPE.finditer(claims)]
    sizes = [struct.unpack_from(">II", claims, start) for start in starts]
    if not sizes:
        return None
    coded = [size for item in _item_payloads(data) for size in _coded_sizes(item)]
    return max(sizes + coded, key=lambda size: size[0] * size[1])


def avif_transfer(data: bytes) -> int:
    """Code of the transfer function in ITU-T H.273 that the first item states; 0 for none."""
    found = _NCLX.search(data, 0, data.find(b"mdat"))
    return int.from_bytes(found[1], "big") if found else 0


def _item_payloads(data: bytes) -> Iterator[memoryview]:
    """The content of each item, and the file from each first chunk of an animation on."""
    for found in islice(_STCO.finditer(data), _MAX_TRACKS):
        count, at = struct.unpack_from(">II", data, found.end())
        if count:
            yield memoryview(data)[at:]
    meta = find_box(data, b"meta")[4:]  # a version comes before its boxes
    iloc = find_box(meta, b"iloc")
    if not iloc:
        return
    inside, left = find_box(meta, b"idat"), _MAX_OVERLAP * len(data)
    for is_inside, extents in item_locations(iloc):
        whole = memoryview(inside if is_inside else data)
        has_open_part = len(extents) > 1 and not all(n for _, n in extents)
        for rest in (None, 0) if has_open_part else (None,):  # decoders differ
            parts = [whole[at : at + n if n else rest] for at, n in extents]
            left -= sum(map(len, parts))
            if left < 0:
                raise struct.error("items hold more than the file")
            yield memoryview(b"".join(parts))


def _coded_sizes(item: memoryview) -> list[tuple[int, int]]:
    """(width, height) of each sequence header; empty if the item is not AV1 but, say, metadata."""
    sizes: list[tuple[int, int]] = []
    with suppress(struct.error, IndexError):  # the item's end, if not one within a header
        sizes.extend(_sequence_sizes(item))
    return sizes


def _sequence_sizes(item: memoryview) -> Iterator[tuple[int, int]]:
    at = 0
    for _ in range(_MAX_OBUS):
        head = item[at]
        if head & 0x81 or not head & 2:  # without a size field, or not AV1
            return
        at += 2 if head & 4 else 1
        length, at = _leb128(item, at)
        if head >> 3 == _SEQUENCE_HEADER:
            yield _sequence_size(item[at : at + min(length, _SEQUENCE_HEADER_BYTES)])
        at += length


def _leb128(data: memoryview, at: int) -> tuple[int, int]:
    """A number and the position after it."""
    value = 0
    for shift in range(0, 56, 7):
        value |= (data[at] & 0x7F) << shift
        at += 1
        if data[at - 1] < 0x80:
            break
    return value, at


class _BitReader:
    """Reads unsigned integers of a given number of bits."""

    def __init__(self, data: memoryview) -> None:
        self._value, self._left = int.from_bytes(data, "big"), 8 * len(data)

    def read(self, count: int) -> int:
        self._left -= count
        if self._left < 0:
            raise struct.error("the sequence header is cut short")
        return self._value >> self._left & ((1 << count) - 1)


def _sequence_size(header: memoryview) -> tuple[int, int]:
    bits = _BitReader(header)
    bits.read(4)  # profile, still picture
    if bits.read(1):
        bits.read(5)  # level, in the reduced header of a still picture
    else:
        _skip_operating_points(bits)
    width_bits, height_bits = bits.read(4) + 1, bits.read(4) + 1
    return bits.read(width_bits) + 1, bits.read(height_bits) + 1


def _skip_operating_points(bits: _BitReader) -> None:
    delay_bits = 0
    if bits.read(1):  # timing
        bits.read(64)
        if bits.read(1):
            zeros = 0
            while not bits.read(1):
                zeros += 1
            bits.read(zeros)
        if bits.read(1):  # decoder model
            delay_bits = bits.read(5) + 1
            bits.read(42)
    has_delay = bits.read(1)
    for _ in range(bits.read(5) + 1):
        bits.read(12)
        if bits.read(5) > 7:
            bits.read(1)
        if delay_bits and bits.read(1):
            bits.read(2 * delay_bits + 1)
        if has_delay and bits.read(1):
            bits.read(4)


_HEVC_BRANDS = frozenset((b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs"))
_AVIF_BRANDS = frozenset((b"avif", b"avis"))
_MAX_BRANDS_BYTES = 256


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
