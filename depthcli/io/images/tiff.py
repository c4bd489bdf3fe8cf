"""The first picture of a TIFF file (TIFF 6.0, and BigTIFF): its size and integrity; the others."""

import struct
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from typing import NamedTuple

_SUBFILE_TYPE, _REDUCED, _REDUCED_OR_MASK, _SUB_DIRECTORIES = 254, 0b1, 0b101, 330
_WIDTH, _HEIGHT, _BITS, _COMPRESSION = 256, 257, 258, 259
_PHOTOMETRIC, _SAMPLES, _PLANES, _EXTRA_SAMPLES, _FORMATS, _FLOAT = 262, 277, 284, 338, 339, 3
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _PLANAR, _EIGHT = (0,), (1,), (2,), 8
_ASSOCIATED, _UNASSOCIATED = 1, 2  # alpha: whether colours are multiplied by it
_STRIPS, _TILES = (273, 279), (324, 325)
"""Tags of the offsets and the byte counts of the pixels."""
_FIELD_TYPES = {1: "B", 3: "H", 4: "I", 8: "h", 9: "i", 13: "I", 16: "Q"}
_DEFLATE = frozenset({8, 32946})
# With any other, OpenCV returns a black picture.
_SUPPORTED_COMPRESSIONS = frozenset(
    {1, 2, 3, 4, 5, 6, 7, 32773, 34676, 34677, 34887, 34925, 50000, 50001}
)
_SUPPORTED_COMPRESSIONS |= _DEFLATE
_CHECKED_TAGS = (
    *(_BITS, _COMPRESSION, _PHOTOMETRIC, _SAMPLES, _PLANES, _FORMATS),
    *_STRIPS,
    *_TILES,
)
_PIECE_BYTES = 2**20


class _TiffLayout(NamedTuple):
    """The layout of TIFF and BigTIFF: formats of `struct`, offsets in bytes."""

    order: str
    start: int
    number: str
    total: str
    entry: int
    value: int


_LAYOUTS = {
    b"II*\0": _TiffLayout("<", 4, "I", "H", 12, 8),
    b"MM\0*": _TiffLayout(">", 4, "I", "H", 12, 8),
    b"II+\0": _TiffLayout("<", 8, "Q", "Q", 20, 12),
    b"MM\0+": _TiffLayout(">", 8, "Q", "Q", 20, 12),
}
TIFF_STARTS = tuple(_LAYOUTS)


def tiff_tags(
    data: bytes, wanted: Collection[int], at: int | None = None
) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Wanted tags that a file has, with their values; it starts with one of ``TIFF_STARTS``.

    Raises:
        struct.error: the file is truncated.
    """
    for tag, form, position in _entries(data, wanted, at):
        yield tag, _unpack(form, data, position)


def with_colours_as_stored(data: bytes) -> bytes:
    """The file with its alpha declared as associated, so that no decoder multiplies colours by it.

    A truncated one is returned as it is.
    """
    with suppress(struct.error):
        for _, form, position in _entries(data, (_EXTRA_SAMPLES,), None):
            values = _unpack(form, data, position)
            if _UNASSOCIATED in values:
                declared = (_ASSOCIATED if value == _UNASSOCIATED else value for value in values)
                tail = position + struct.calcsize(form)
                return data[:position] + struct.pack(form, *declared) + data[tail:]
    return data


def _entries(
    data: bytes, wanted: Collection[int], at: int | None
) -> Iterator[tuple[int, str, int]]:
    """Wanted tags of a directory, with the format and the position of their values."""
    layout = _LAYOUTS[data[:4]]
    order, number = layout.order, layout.order + layout.number
    if at is None:
        (at,) = _unpack(number, data, layout.start)
    (count,) = _unpack(order + layout.total, data, at)
    first = at + struct.calcsize(layout.total)
    for entry in range(first, min(first + layout.entry * count, len(data)), layout.entry):
        tag, kind = _unpack(order + "HH", data, entry)
        if tag in wanted and kind in _FIELD_TYPES:
            (many,) = _unpack(number, data, entry + 4)
            form, position = f"{order}{many}{_FIELD_TYPES[kind]}", entry + layout.value
            if struct.calcsize(form) > struct.calcsize(number):
                (position,) = _unpack(number, data, position)
            yield tag, form, position


def _unpack(form: str, data: bytes, at: int) -> tuple[int, ...]:
    """As ``struct.unpack_from``, at a position of any size."""
    return struct.unpack(form, data[at : at + struct.calcsize(form)])


def tiff_directories(data: bytes) -> Iterator[bool]:
    """For each directory in the file's chain, whether it is a picture of its own.

    Others are reduced copies (thumbnails) and masks.

    Raises:
        struct.error: the file is truncated.
    """
    layout, seen = _LAYOUTS[data[:4]], {0}
    order, number = layout.order, layout.order + layout.number
    (at,) = _unpack(number, data, layout.start)
    while at not in seen:
        seen.add(at)
        (count,) = _unpack(order + layout.total, data, at)
        first = at + struct.calcsize(layout.total)
        (at,) = _unpack(number, data, first + layout.entry * count)
        (tag,) = _unpack(order + "H", data, first)  # in ascending order, so this one is first
        (kind,) = _unpack(order + "I", data, first + layout.value)
        yield not (tag == _SUBFILE_TYPE and kind & _REDUCED_OR_MASK)


def has_thumbnail_only(data: bytes) -> bool:
    """Whether the first picture is a reduced copy of one in another chain, as in camera raw files.

    Raises:
        struct.error: the file is truncated.
    """
    tags = dict(tiff_tags(data, (_SUBFILE_TYPE, _SUB_DIRECTORIES)))
    is_reduced = any(kind & _REDUCED for kind in tags.get(_SUBFILE_TYPE, ()))
    return is_reduced and bool(tags.get(_SUB_DIRECTORIES))


def tiff_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) that the file states; None if it does not.

    Raises:
        struct.error: the file is truncated.
    """
    tags = dict(tiff_tags(data, (_WIDTH, _HEIGHT)))
    return (tags[_WIDTH][0], tags[_HEIGHT][0]) if all(map(tags.get, (_WIDTH, _HEIGHT))) else None


def tiff_bits(data: bytes) -> int:
    """Bits of a channel, which packed files have other numbers of than 8 or 16; 1 if not stated."""
    try:
        tags = dict(tiff_tags(data, (_BITS,)))
    except struct.error:
        return 1
    return max(tags.get(_BITS, ()), default=1)


def tiff_problem(data: bytes) -> str | None:
    """A problem with the compression or a strip of a TIFF, in words; None if there is none.

    OpenCV returns black pixels for what libtiff cannot read. Deflate alone has checksums, which
    libtiff does not verify; damage in other compressions is reported by the decoder, if at all.

    Args:
        data: the whole file.
    """
    try:
        tags = dict(tiff_tags(data, _CHECKED_TAGS))
    except struct.error:
        return "is truncated (the TIFF's directory is incomplete); copy it again"
    coding = (*tags.get(_COMPRESSION, ()), 1)[0]
    if coding not in _SUPPORTED_COMPRESSIONS:
        return f"has the unknown TIFF compression {coding}; save it without one"
    return _unsupported(tags) or next(_strip_problems(data, tags, coding), None)


def _unsupported(tags: Mapping[int, tuple[int, ...]]) -> str | None:
    """A feature that OpenCV ignores in files of more than 8 bits, in words; None without one."""
    bits = tags.get(_BITS, (1,))
    if max(bits, default=1) <= _EIGHT:
        return None
    if tags.get(_PLANES) == _PLANAR and len(bits) > 1:
        return "has a plane for each colour and more than 8 bits; save it with interleaved colours"
    photometric, samples = tags.get(_PHOTOMETRIC), tags.get(_SAMPLES, (1,))
    if photometric in (_WHITE_IS_ZERO, _BLACK_IS_ZERO) and samples > (1,):
        is_float = tags.get(_FORMATS, (1,))[:1] == (_FLOAT,)
        if samples[0] > 2 and not is_float:  # noqa: PLR2004 - those of gray with alpha
            return f"has {samples[0]} channels that are declared gray; save it as RGB"
        if samples == (2,):
            return "has gray with alpha and more than 8 bits; save it without alpha"
    if photometric == _WHITE_IS_ZERO:
        return "has 0 for white and more than 8 bits; save it with 0 for black"
    return None


def _strip_problems(data: bytes, tags: Mapping[int, tuple[int, ...]], coding: int) -> Iterator[str]:
    for offsets, sizes in (_STRIPS, _TILES):
        for at, size in zip(tags.get(offsets, ()), tags.get(sizes, ()), strict=False):
            if at + size > len(data):
                yield "is truncated (pixels of the TIFF are missing); copy it again"
            elif coding in _DEFLATE and not _inflates(data[at : at + size]):
                yield "is damaged (a part of the TIFF cannot be inflated); copy it again"


def _inflates(part: bytes) -> bool:
    """Whether a Deflate stream is complete and its checksum is right."""
    stream = zlib.decompressobj()
    try:
        while part and not stream.eof:
            stream.decompress(part, _PIECE_BYTES)
            part = stream.unconsumed_tail
    except zlib.error:
        return False
    return stream.eof
