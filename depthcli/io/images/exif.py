"""Facts in images: directories of TIFF 6.0, EXIF in them, tone curves of ICC profiles."""

import math
import struct
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from numbers import Real
from typing import Any, NamedTuple

from depthcli.core.camera import FILM_DIAGONAL_MM
from depthcli.errors import Message

_FIELD_TYPES = {1: "B", 3: "H", 4: "I", 5: "II", 7: "B", 8: "h", 9: "i", 13: "I", 16: "Q"}
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
    data: bytes, wanted: Collection[int], at: int | None = None
) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Wanted tags of the directory at a position, or of the first, with their values."""
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
_TAGS = (_ORIENTATION, EXIF_IFD, _FOCAL_MM, _FOCAL_35MM, *_SIZE_PX, *_PLANE, _PLANE_UNIT)
_UNITS_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}
_LEAST_35MM, _MOST_35MM = 3, 20_000  # from fisheyes to telescopes; others are mistakes
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
            focal_35mm if _LEAST_35MM <= (focal_35mm or 0) <= _MOST_35MM else None,
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
    found: dict[int, float] = {}
    with suppress(struct.error):
        for tag, form, position in tag_entries(tiff, _TAGS, at):
            values = unpack_at(form, tiff, position)
            if tag in _RATIONALS:
                found.update({tag: values[0] / values[1]} if len(values) > 1 and values[1] else {})
            elif values:
                found[tag] = values[0]
    return found


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
        if count < 2:  # noqa: PLR2004 - no curve, or its gamma
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
