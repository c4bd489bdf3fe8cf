"""Size and transfer function of an AVIF's pictures, by boxes and AV1 sequence headers (5.5.1)."""

import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice

from depthcli.io.pictures.boxes import find_box, item_locations

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
