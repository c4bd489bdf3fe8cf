"""The two EXIF tags that depth estimation needs: orientation and focal length."""

import struct
from contextlib import suppress
from typing import NamedTuple

from depthcli.io.images.tiff import TIFF_STARTS, read_tags

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
