"""Directories of TIFF 6.0 and BigTIFF; the two EXIF tags in them that depth estimation needs."""

import struct
from collections.abc import Collection, Iterator
from contextlib import suppress
from typing import NamedTuple

_FIELD_TYPES = {1: "B", 3: "H", 4: "I", 8: "h", 9: "i", 13: "I", 16: "Q"}


class _Layout(NamedTuple):
    """Layout of TIFF and BigTIFF: formats of `struct`, offsets in bytes."""

    order: str
    start: int
    number: str
    total: str
    entry: int
    value: int


LAYOUTS = {
    b"II*\0": _Layout("<", 4, "I", "H", 12, 8),
    b"MM\0*": _Layout(">", 4, "I", "H", 12, 8),
    b"II+\0": _Layout("<", 8, "Q", "Q", 20, 12),
    b"MM\0+": _Layout(">", 8, "Q", "Q", 20, 12),
}
TIFF_STARTS = tuple(LAYOUTS)


def read_tags(
    data: bytes, wanted: Collection[int], at: int | None = None
) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Wanted tags of a directory with their values.

    Args:
        data: it starts with one of ``TIFF_STARTS``.
        wanted: their numbers.
        at: position of the directory; None for the first.
    """
    for tag, form, position in tag_entries(data, wanted, at):
        yield tag, unpack_at(form, data, position)


def tag_entries(
    data: bytes, wanted: Collection[int], at: int | None
) -> Iterator[tuple[int, str, int]]:
    """Wanted tags of a directory, with the format and the position of their values."""
    layout = LAYOUTS[data[:4]]
    order, number = layout.order, layout.order + layout.number
    if at is None:
        (at,) = unpack_at(number, data, layout.start)
    (count,) = unpack_at(order + layout.total, data, at)
    first = at + struct.calcsize(layout.total)
    for entry in range(first, min(first + layout.entry * count, len(data)), layout.entry):
        tag, kind = unpack_at(order + "HH", data, entry)
        if tag in wanted and kind in _FIELD_TYPES:
            (many,) = unpack_at(number, data, entry + 4)
            form, position = f"{order}{many}{_FIELD_TYPES[kind]}", entry + layout.value
            if struct.calcsize(form) > struct.calcsize(number):
                (position,) = unpack_at(number, data, position)
            yield tag, form, position


def unpack_at(form: str, data: bytes, at: int) -> tuple[int, ...]:
    """Unpack as ``struct.unpack_from``, at a position of any size."""
    return struct.unpack(form, data[at : at + struct.calcsize(form)])


ORIENTATION, EXIF_IFD, FOCAL_35MM = 0x0112, 0x8769, 0xA405
"""Tags, the second of which is the place of the directory with the third."""
_ORIENTATIONS = range(1, 9)
_FOCAL_35MM_MM = range(3, 20_001)  # from fisheyes to telescopes; others are mistakes


class Exif(NamedTuple):
    """Orientation and focal length."""

    orientation: int = 1  #: 1-8; 1 is upright
    focal_35mm: float | None = None  #: 35-mm-equivalent focal length in millimetres, or None

    @classmethod
    def of(cls, orientation: object, focal_35mm: object) -> "Exif":
        """Values of tags; those that no camera writes count as absent."""
        return cls(
            orientation if isinstance(orientation, int) and orientation in _ORIENTATIONS else 1,
            float(focal_35mm)
            if isinstance(focal_35mm, int) and focal_35mm in _FOCAL_35MM_MM
            else None,
        )


def parse_exif(block: bytes) -> Exif:
    """EXIF of the TIFF structure that it is, or of a TIFF file; damaged tags count as absent."""
    tiff = block.removeprefix(b"Exif\0\0")
    if not tiff.startswith(TIFF_STARTS):
        return Exif()
    first = _first_values(tiff)
    inner = _first_values(tiff, first[EXIF_IFD]) if EXIF_IFD in first else {}
    return Exif.of(first.get(ORIENTATION), inner.get(FOCAL_35MM))


def _first_values(tiff: bytes, at: int | None = None) -> dict[int, int]:
    """The first value of each tag of a directory, as far as that goes."""
    found = {}
    with suppress(struct.error):
        for tag, values in read_tags(tiff, (ORIENTATION, EXIF_IFD, FOCAL_35MM), at):
            found.update({tag: values[0]} if values else {})
    return found
