"""Whole-number tags of a TIFF file's first picture (TIFF 6.0, and BigTIFF)."""

import struct
from collections.abc import Collection
from typing import NamedTuple

WIDTH, HEIGHT, COMPRESSION = 256, 257, 259


class _Layout(NamedTuple):
    """Where TIFF and its 64-bit form keep things: forms of `struct`, offsets in bytes."""

    order: str
    start: int
    number: str
    total: str
    entry: int
    value: int


_LAYOUTS = {
    b"II*\0": _Layout("<", 4, "I", "H", 12, 8),
    b"MM\0*": _Layout(">", 4, "I", "H", 12, 8),
    b"II+\0": _Layout("<", 8, "Q", "Q", 20, 12),
    b"MM\0+": _Layout(">", 8, "Q", "Q", 20, 12),
}
TIFF_STARTS = tuple(_LAYOUTS)


def tiff_tags(data: bytes, wanted: Collection[int]) -> dict[int, int]:
    """Those of the wanted tags, with one value, that a file has; it has one of the ``TIFF_STARTS``.

    Raises:
        struct.error: the file is too short for what it claims.
    """
    layout = _LAYOUTS[data[:4]]
    order, number = layout.order, layout.order + layout.number
    (at,) = struct.unpack_from(number, data, layout.start)
    if at >= len(data):
        raise struct.error("the directory lies after the file's end")
    (count,) = struct.unpack_from(layout.order + layout.total, data, at)
    first = at + struct.calcsize(layout.total)
    found = {}
    for entry in range(first, min(first + layout.entry * count, len(data)), layout.entry):
        tag, kind = struct.unpack_from(order + "HH", data, entry)
        if tag in wanted:
            form = order + {3: "H", 16: "Q"}.get(kind, "I")
            (found[tag],) = struct.unpack_from(form, data, entry + layout.value)
    return found
