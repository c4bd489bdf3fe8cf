"""Directories of TIFF 6.0: TIFF images, and EXIF in all images; tone curves of ICC profiles."""

import math
import struct
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from numbers import Real
from typing import Any, NamedTuple

from depthcli.core.camera import FILM_DIAGONAL_MM, FOCAL_35MM
from depthcli.errors import InputError, Message
from depthcli.io.images import opencv, openimageio

_FIELD_TYPES = {1: "B", 2: "B", 3: "H", 4: "I", 5: "II", 7: "B", 8: "h", 9: "i", 13: "I", 16: "Q"}
"""Formats of `struct` by the number of a type; a rational is two numbers."""


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
    data: bytes, tags: Collection[int], at: int | None = None
) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Wanted tags of the directory at a position, or of the first, with their values."""
    for tag, form, position in tag_entries(data, tags, at):
        yield tag, unpack_at(form, data, position)


def tag_entries(
    data: bytes, tags: Collection[int], at: int | None = None
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
        if tag in tags and kind in _FIELD_TYPES:
            (many,) = unpack_at(number, data, entry + 4)
            letters = _FIELD_TYPES[kind]
            form, position = f"{order}{many * len(letters)}{letters[0]}", entry + layout.value
            if struct.calcsize(form) > struct.calcsize(number):
                (position,) = unpack_at(number, data, position)
            yield tag, form, position


def unpack_at(form: str, data: bytes, at: int) -> tuple[int, ...]:
    """Unpack as ``struct.unpack_from``, at a position of any size."""
    return struct.unpack(form, data[at : at + struct.calcsize(form)])


_ORIENTATION, EXIF_IFD = 0x0112, 0x8769
_FOCAL_MM, _FOCAL_35MM, _SIZE_PX = 0x920A, 0xA405, (0xA002, 0xA003)
_PLANE, _PLANE_UNIT = (0xA20E, 0xA20F), 0xA210  # pixels a unit on the sensor, across and down
_EXIF_TAGS = (_ORIENTATION, EXIF_IFD, _FOCAL_MM, _FOCAL_35MM, *_SIZE_PX, *_PLANE, _PLANE_UNIT)
_UNITS_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}
_SENSOR_MM = 3.0, 100.0  # diagonals, from phones to medium format
_SQUARE = 0.1
_RATIONALS = {_FOCAL_MM, *_PLANE}


class Exif(NamedTuple):
    """Orientation and focal length; values that no camera writes count as absent."""

    orientation: int = 1  #: 1-8; 1 is upright
    focal_35mm: float | None = None  #: 35-mm-equivalent focal length in millimetres, or None
    focal_mm: float | None = None  #: that of the lens, in millimetres, or None

    @classmethod
    def of(cls, tags: Mapping[int, Any]) -> "Exif":
        """From the values of both directories, by tag."""
        numbers = {tag: float(v) for tag, v in tags.items() if isinstance(v, Real)}
        numbers = {tag: v for tag, v in numbers.items() if 0 < v < math.inf}
        orientation, focal_mm = numbers.get(_ORIENTATION, 1), numbers.get(_FOCAL_MM)
        focal_35mm = numbers.get(_FOCAL_35MM) or _equivalent(numbers)
        return cls(
            int(orientation) if orientation in range(1, 9) else 1,
            focal_35mm if FOCAL_35MM.holds(focal_35mm or 0) else None,
            focal_mm,
        )


def _equivalent(tags: Mapping[int, float]) -> float | None:
    """35-mm equivalent by the size of the sensor, as of Canon's cameras; None if it is unknown.

    The sensor's pixels are those of the image as it left the camera, so resizing changes nothing.
    Sizes with pixels that are not square, or that no sensor has, are mistakes.
    """
    if not tags.keys() >= {_FOCAL_MM, *_SIZE_PX, *_PLANE}:
        return None
    unit_mm = _UNITS_MM.get(int(tags.get(_PLANE_UNIT, 2)), 25.4)
    pitches = [unit_mm / tags[tag] for tag in _PLANE]
    diagonal_mm = math.hypot(*(tags[n] * mm for n, mm in zip(_SIZE_PX, pitches, strict=True)))
    is_likely = _SENSOR_MM[0] <= diagonal_mm <= _SENSOR_MM[1]
    if not is_likely or abs(pitches[0] / pitches[1] - 1) > _SQUARE:
        return None
    return tags[_FOCAL_MM] * FILM_DIAGONAL_MM / diagonal_mm


def parse_exif(block: bytes) -> Exif:
    """EXIF of the TIFF structure that it is, or of a TIFF file; damaged tags count as absent."""
    tiff = block.removeprefix(b"Exif\0\0")
    if not tiff.startswith(TIFF_STARTS):
        return Exif()
    first = _first_values(tiff)
    inner = _first_values(tiff, int(first[EXIF_IFD])) if EXIF_IFD in first else {}
    return Exif.of({**inner, **first})


def _first_values(tiff: bytes, at: int | None = None) -> dict[int, float]:
    """The first value of each tag of a directory, as far as that goes."""
    firsts: dict[int, float] = {}
    with suppress(struct.error):
        for tag, values in read_tags(tiff, _EXIF_TAGS, at):
            if tag in _RATIONALS:
                firsts.update({tag: values[0] / values[1]} if len(values) > 1 and values[1] else {})
            elif values:
                firsts[tag] = values[0]
    return firsts


_ICC_SIGN, _ICC_SIGN_AT, _ICC_TAGS_AT = b"acsp", 36, 128
_TONE_CURVES = (b"gTRC", b"kTRC")  # of green, and of gray
_SRGB_MIDDLE, _OTHER = 0.214, 0.05  # light at half the signal, and a difference that matters


def profile_warning(data: bytes) -> str | None:
    """A warning about an ICC profile (ICC.1:2022) with another tone curve than sRGB's.

    Those of ProPhoto (gamma 1.8) and of linear light change depth by 8 % and more; other primaries
    hardly do. ``data`` is a profile, or a file that holds one.
    """
    at = data.find(_ICC_SIGN) - _ICC_SIGN_AT
    light = None
    with suppress(struct.error, ValueError):
        light = _light_at_half(data[at:]) if at >= 0 else None
    if light is None or abs(light - _SRGB_MIDDLE) < _OTHER:
        return None
    return Message(
        f"its colour profile is not used, and has half the signal for {light:.0%} of the light, "
        f"not {_SRGB_MIDDLE:.0%} as sRGB",
        "convert it to sRGB for better depth",
    )


def _light_at_half(profile: bytes) -> float | None:
    """Light, from 0 to 1, at half the signal; None if the profile has no such curve."""
    (count,) = struct.unpack_from(">I", profile, _ICC_TAGS_AT)
    tags = struct.iter_unpack(">4sII", profile[_ICC_TAGS_AT + 4 :][: 12 * min(count, 100)])
    start = next((at for name, at, _ in tags if name in _TONE_CURVES), None)
    if start is None:
        return None
    if profile[start : start + 4] == b"curv":
        (count,) = struct.unpack_from(">I", profile, start + 8)
        if count < 2:  # no curve, or its gamma
            gamma = struct.unpack_from(">H", profile, start + 12)[0] / 256 if count else 1.0
            return float(0.5**gamma)
        values = struct.unpack_from(">2H", profile, start + 12 + 2 * ((count - 1) // 2))
        return float(values[0] if count % 2 else sum(values) / 2) / 0xFFFF
    if profile[start : start + 4] == b"para":
        (form,) = struct.unpack_from(">H", profile, start + 8)
        words = struct.unpack_from(">3i" if form else ">i", profile, start + 12)
        gamma, a, b = (word / 65536 for word in (words if form else (*words, 65536, 0)))
        return float((0.5 * a + b) ** gamma)
    return None


_SUBFILE_TYPE, _REDUCED, _REDUCED_OR_MASK, _SUB_DIRECTORIES = 254, 0b1, 0b101, 330
_WIDTH, _HEIGHT, _BITS, _COMPRESSION = 256, 257, 258, 259
_PHOTOMETRIC, _SAMPLES, _PLANES, _EXTRA_SAMPLES, _FORMATS = 262, 277, 284, 338, 339
_ROWS_PER_STRIP, _TILE_WIDTH, _TILE_HEIGHT, _TILE_BYTES = 278, 322, 323, 1024
_TAGS = (
    *(_SUBFILE_TYPE, _SUB_DIRECTORIES, _WIDTH, _HEIGHT, _BITS, _COMPRESSION),
    *(_PHOTOMETRIC, _SAMPLES, _PLANES, _EXTRA_SAMPLES, _FORMATS),
    *(_ROWS_PER_STRIP, _TILE_WIDTH, _TILE_HEIGHT),
)
_ASSOCIATED, _UNASSOCIATED = 1, 2  # alpha: whether colours are multiplied by it
_EIGHT, _SIXTEEN, _MAX_CHANNELS = 8, 16, 4
_GDAL_NODATA = 42113
# With any other, OpenCV returns a black image.
_COMPRESSIONS_OF_OPENCV = frozenset({1, 2, 3, 4, 5, 6, 7, 8, 32773, 32946, 34676, 34677})
_UNCOMPRESSED, _DEFLATE = 1, (8, 32946)
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB, _PLANAR, _FLOAT = 0, 1, 2, 2, 3
_SUBSAMPLED, _CHANNELS = 6, {_RGB: 3, 5: 4, 6: 3}  # by photometric interpretation, at least
_STRIPS, _TILES = (273, 279), (324, 325)  # offsets and bytes of each
_MISSING = InputError("is damaged (strips or tiles of the TIFF are missing)", "copy it again")


def tiff_header(data: bytes) -> opencv.Header:
    """Size of the first image of a TIFF, the value of its white, and how many others there are."""
    tags = _first_directory(data)
    if tags.get(_SUBFILE_TYPE, 0) & _REDUCED and _SUB_DIRECTORIES in tags:
        thumbnail = "has a thumbnail as its first image, as camera raw files do"
        raise InputError(thumbnail, "convert it to JPEG, PNG or TIFF first")
    problem = _not_for_opencv(tags)
    if problem:
        openimageio.needs_openimageio(problem)
    bits, count = tags.get(_BITS, 1), _image_count(data)
    return opencv.Header(
        tags[_WIDTH],
        tags[_HEIGHT],
        f"has {count} images; only the first is used" if count > 1 else None,
        # OpenCV shifts packed bits to the left.
        white=(1 << _SIXTEEN) - (1 << _SIXTEEN - bits) if _EIGHT < bits < _SIXTEEN else None,
        is_upright=True,
    )


def decode_tiff(data: bytes) -> opencv.Decoded:
    """Pixels of the first image, upright, because OpenCV's reader always turns it."""
    tags = _first_directory(data)
    if _not_for_opencv(tags):
        return openimageio.decode_openimageio(data)
    _check_content(data, tags)
    has_alpha = tags.get(_EXTRA_SAMPLES) in (_ASSOCIATED, _UNASSOCIATED)
    pixels = opencv.decode_with_opencv(_with_colours_as_stored(data), has_alpha=has_alpha)
    return pixels._replace(exif=data)


def _first_directory(data: bytes) -> dict[int, int]:
    """The first value of each tag of the first image; of the bits, their maximum."""
    entries = {tag: values for tag, values in read_tags(data, _TAGS) if values}
    return {tag: max(values) if tag == _BITS else values[0] for tag, values in entries.items()}


def _not_for_opencv(tags: Mapping[int, int]) -> str | None:
    """Reason why OpenCV would decode wrong pixels without an error; None if it does not."""
    coding, channels = tags.get(_COMPRESSION, 1), tags.get(_SAMPLES, 1)
    if coding not in _COMPRESSIONS_OF_OPENCV:
        return f"has the TIFF compression {coding}"
    if channels > _MAX_CHANNELS:
        return f"has {channels} channels"
    if tags.get(_BITS, 1) <= _EIGHT:
        tile = tags.get(_TILE_WIDTH, 0) * tags.get(_TILE_HEIGHT, 0) * channels
        # OpenCV takes tifffile's and tiffcp's for damaged.
        is_odd = coding == _UNCOMPRESSED and tile % _TILE_BYTES
        return "has uncompressed tiles of no whole number of kilobytes" if is_odd else None
    is_float = tags.get(_FORMATS, 1) == _FLOAT
    if is_float and tags[_BITS] == _SIXTEEN:
        return "has half-precision floats"
    if tags.get(_PLANES, 1) == _PLANAR and channels > 1:
        return "has a plane for each colour and more than 8 bits"
    photometric = tags.get(_PHOTOMETRIC, _RGB)
    if photometric == _WHITE_IS_ZERO:
        return "has 0 for white and more than 8 bits"
    is_for_gray = channels == 1 or (is_float and channels > 2)
    if photometric == _BLACK_IS_ZERO and not is_for_gray:
        return f"has gray in {channels} channels and more than 8 bits"
    return None


def _check_content(data: bytes, tags: Mapping[int, int]) -> None:
    """Check that a file holds all that its tags state, as OpenCV decodes it with zeros otherwise.

    It passes over libtiff's errors in images of 8 bits, so Deflate is decompressed here as well.
    """
    channels, photometric = tags.get(_SAMPLES, 1), tags.get(_PHOTOMETRIC, _BLACK_IS_ZERO)
    if channels < _CHANNELS.get(photometric, 1):
        raise InputError(f"is damaged (colours in {channels} channels)", "copy it again")
    width, height = tags[_WIDTH], tags[_HEIGHT]
    across, down = tags.get(_TILE_WIDTH, width), tags.get(_TILE_HEIGHT)
    names = _STRIPS if down is None else _TILES
    down = down or min(tags.get(_ROWS_PER_STRIP, height), height)
    planes = channels if tags.get(_PLANES) == _PLANAR else 1
    entries = dict(read_tags(data, names))
    offsets, sizes = (entries.get(name, ()) for name in names)
    rows = -(-height // max(1, down))
    count = rows * -(-width // max(1, across)) * planes
    coding, bits = tags.get(_COMPRESSION, 1), tags.get(_BITS, 1)
    if coding == _UNCOMPRESSED and not sizes:  # of programs of the nineties
        sizes = (0,) * count
    if not 0 < count <= min(len(offsets), len(sizes)):
        raise _MISSING
    row_bytes = 0 if photometric == _SUBSAMPLED else -(-across * channels // planes * bits // 8)
    for at, (offset, size) in enumerate(zip(offsets[:count], sizes, strict=False)):
        is_last = names is _STRIPS and at % rows == rows - 1
        needed = row_bytes * (height - down * (rows - 1) if is_last else down)
        least = needed if coding == _UNCOMPRESSED else max(size, 1)
        part = data[offset : offset + least]
        if len(part) == least and coding in _DEFLATE and bits <= _EIGHT:
            least, part = needed, zlib.decompressobj().decompress(part, row_bytes * down + 1)
        if len(part) < least:
            raise _MISSING


def _with_colours_as_stored(data: bytes) -> bytes:
    """The file with its alpha declared associated, so that no decoder multiplies by it."""
    with suppress(struct.error):
        for _, form, position in tag_entries(data, (_EXTRA_SAMPLES,)):
            values = unpack_at(form, data, position)
            if _UNASSOCIATED in values:
                declared = (_ASSOCIATED if value == _UNASSOCIATED else value for value in values)
                tail = position + struct.calcsize(form)
                return data[:position] + struct.pack(form, *declared) + data[tail:]
    return data


def no_data_value(data: bytes) -> float:
    """The number that stands for no data in a TIFF by GDAL's tag; NaN if it states none."""
    with suppress(struct.error, ValueError, KeyError):
        for _, text in read_tags(data, (_GDAL_NODATA,)):
            return float(bytes(text).strip(b" \0"))
    return math.nan


def _image_count(data: bytes) -> int:
    """Directories in the file's chain, without reduced copies (thumbnails) and masks."""
    layout, visited, count = LAYOUTS[data[:4]], {0}, 0
    order, number = layout.order, layout.order + layout.number
    with suppress(struct.error):  # decoders, too, pass over what follows the first image
        (at,) = unpack_at(number, data, layout.start)
        while at not in visited:
            visited.add(at)
            kinds = dict(read_tags(data, (_SUBFILE_TYPE,), at)).get(_SUBFILE_TYPE) or (0,)
            count += not count or not kinds[0] & _REDUCED_OR_MASK
            (entries,) = unpack_at(order + layout.total, data, at)
            at += struct.calcsize(layout.total) + layout.entry * entries
            (at,) = unpack_at(number, data, at)
    return count
