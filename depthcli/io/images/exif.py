"""The two EXIF tags that depth estimation needs: orientation and focal length."""

import struct
from collections.abc import Collection
from contextlib import suppress
from typing import NamedTuple

from depthcli.io.images.isobmff import find_box, heif_exif
from depthcli.io.images.jpeg import JPEG_START, jpeg_segments
from depthcli.io.images.png import SIGNATURE, read_chunks
from depthcli.io.images.tiff import TIFF_STARTS, tiff_tags
from depthcli.io.images.webp import riff_chunks

ORIENTATION, EXIF_IFD, FOCAL_35MM = 0x0112, 0x8769, 0xA405
"""Tags, the second of which is the place of the directory with the third."""
_ORIENTATIONS = range(1, 9)
_FOCAL_35MM_MM = range(3, 20_001)  # from fisheyes to telescopes; others are mistakes
_APP1, _HEAD = 0xE1, b"Exif\0\0"
_ROTATED = (1, 8, 3, 6)  # EXIF orientations that quarter turns counter-clockwise make upright
_MIRRORED = (2, 5, 4, 7)  # and those that mirroring left to right and then such turns do


class Exif(NamedTuple):
    """Orientation and focal length."""

    orientation: int = 1  #: 1-8; 1 is upright
    focal_35mm: float | None = None  #: 35-mm-equivalent focal length in millimetres, or None


def read_exif(data: bytes) -> Exif:
    """EXIF of a JPEG, PNG, WebP, TIFF, AVIF or HEIF file; damaged tags count as absent.

    The orientation of an AVIF or HEIF file is that of its irot and imir properties.
    """
    if data[4:8] == b"ftyp":
        return Exif(_property_orientation(data), _parse(heif_exif(data)).focal_35mm)
    return _parse(_tiff_part(data))


def plausible_focal(focal_35mm: object) -> float | None:
    """A 35-mm-equivalent focal length in millimetres; None if no camera has it."""
    if isinstance(focal_35mm, int) and focal_35mm in _FOCAL_35MM_MM:
        return float(focal_35mm)
    return None


def _tiff_part(data: bytes) -> bytes:
    """The TIFF structure that EXIF is, wherever the container keeps it; empty if it has none."""
    if data.startswith(SIGNATURE):
        found = (bytes(body) for kind, body, _ in read_chunks(data) if kind == b"eXIf")
    elif data.startswith(JPEG_START):
        parts = (content for marker, content in jpeg_segments(data) if marker == _APP1)
        found = (part for part in parts if part.startswith(_HEAD))
    elif data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        found = (body for kind, body in riff_chunks(data) if kind == b"EXIF")
    else:
        return data
    return next(found, b"").removeprefix(_HEAD)


def _parse(tiff: bytes) -> Exif:
    if not tiff.startswith(TIFF_STARTS):
        return Exif()
    first = _first_values(tiff, (ORIENTATION, EXIF_IFD))
    orientation = first.get(ORIENTATION, 1)
    inner = _first_values(tiff, (FOCAL_35MM,), first[EXIF_IFD]) if EXIF_IFD in first else {}
    return Exif(
        orientation if orientation in _ORIENTATIONS else 1, plausible_focal(inner.get(FOCAL_35MM))
    )


def _first_values(tiff: bytes, wanted: Collection[int], at: int | None = None) -> dict[int, int]:
    """The first value of each wanted tag of a directory, as far as that goes."""
    found = {}
    with suppress(struct.error):
        for tag, values in tiff_tags(tiff, wanted, at):
            found.update({tag: values[0]} if values else {})
    return found


def _property_orientation(data: bytes) -> int:
    """The EXIF orientation that is the same as a file's irot and imir properties."""
    meta = find_box(data, b"meta")[4:]  # a version comes before its boxes
    properties = find_box(find_box(meta, b"iprp"), b"ipco")
    turn, axis = find_box(properties, b"irot")[:1], find_box(properties, b"imir")[:1]
    quarters = turn[0] & 3 if turn else 0
    if not axis:
        return _ROTATED[quarters]
    # Mirroring after a rotation is the opposite rotation after mirroring; top to bottom adds 180°.
    return _MIRRORED[-quarters % 4 if axis[0] & 1 else (2 - quarters) % 4]
