"""The two EXIF facts that depth needs: how the camera was held and its focal length."""

import struct
from collections.abc import Collection
from contextlib import suppress
from typing import NamedTuple

from depthcli.io.pictures.avif import find_box
from depthcli.io.pictures.jpeg import JPEG_START, jpeg_segments
from depthcli.io.pictures.tiff import TIFF_STARTS, tiff_tags
from depthcli.io.png.chunks import SIGNATURE

_ORIENTATION, _EXIF_IFD, _FOCAL_35MM = 0x0112, 0x8769, 0xA405
_ORIENTATIONS = range(1, 9)
_JPEG_EXIF, _EXIF_START = 0xE1, b"Exif\0\0"
_TURNED = (1, 8, 3, 6)  # EXIF orientations that quarter turns counter-clockwise make upright
_MIRRORED = (2, 5, 4, 7)  # and those that mirroring left to right and then such turns do


class Exif(NamedTuple):
    """What was found."""

    orientation: int = 1  #: 1-8; 1 is upright
    focal_35mm: float | None = None  #: 35-mm-equivalent focal length in millimetres, or None


def read_exif(data: bytes) -> Exif:
    """EXIF of a JPEG, PNG, WebP or TIFF file; whatever is damaged counts as absent.

    AVIF has the same turns and mirrors in a form of its own.
    """
    if data[4:8] == b"ftyp":
        return Exif(_avif_orientation(data))
    tiff = _tiff_part(data)
    return Exif() if tiff is None else _parse(tiff)


def _tiff_part(data: bytes) -> bytes | None:
    """The TIFF structure that EXIF is, wherever the container keeps it."""
    if data.startswith(TIFF_STARTS):
        return data
    if data.startswith(JPEG_START):
        bodies = (body for marker, body in jpeg_segments(data) if marker == _JPEG_EXIF)
        found = next((body for body in bodies if body.startswith(_EXIF_START)), None)
        return found and found.removeprefix(_EXIF_START)
    if data.startswith(SIGNATURE):
        return _in_chunks(data, 8, b"eXIf", ">I4s", length_first=True)
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        part = _in_chunks(data, 12, b"EXIF", "<4sI", length_first=False)
        return part.removeprefix(_EXIF_START) if part else None
    return None


def _in_chunks(
    data: bytes, at: int, wanted: bytes, header: str, *, length_first: bool
) -> bytes | None:
    size = struct.calcsize(header)
    while at + size <= len(data):
        first, second = struct.unpack_from(header, data, at)
        length, name = (first, second) if length_first else (second, first)
        if name == wanted:
            return data[at + size : at + size + length]
        # PNG adds a checksum, RIFF pads to even lengths.
        at += size + length + (4 if length_first else length % 2)
    return None


def _parse(tiff: bytes) -> Exif:
    if not tiff.startswith(TIFF_STARTS):
        return Exif()
    first = _first_values(tiff, (_ORIENTATION, _EXIF_IFD))
    orientation = first.get(_ORIENTATION, 1)
    inner = _first_values(tiff, (_FOCAL_35MM,), first[_EXIF_IFD]) if _EXIF_IFD in first else {}
    focal = inner.get(_FOCAL_35MM, 0)
    return Exif(
        orientation if orientation in _ORIENTATIONS else 1, float(focal) if focal > 0 else None
    )


def _first_values(tiff: bytes, wanted: Collection[int], at: int | None = None) -> dict[int, int]:
    """The first value of each wanted tag of a directory, as far as that goes."""
    found = {}
    with suppress(struct.error):
        for tag, values in tiff_tags(tiff, wanted, at):
            found.update({tag: values[0]} if values else {})
    return found


def _avif_orientation(data: bytes) -> int:
    """The EXIF orientation that is the same as a file's irot and imir properties."""
    meta = find_box(data, b"meta")[4:]  # a version comes before its boxes
    properties = find_box(find_box(meta, b"iprp"), b"ipco")
    turn, axis = find_box(properties, b"irot")[:1], find_box(properties, b"imir")[:1]
    quarters = turn[0] & 3 if turn else 0
    if not axis:
        return _TURNED[quarters]
    # Mirroring after a turn is turning the other way after mirroring; top to bottom is two more.
    return _MIRRORED[-quarters % 4 if axis[0] & 1 else -(quarters + 2) % 4]
