"""Scaling pixels whose white is below the maximum of their type."""

import re
from typing import Any

import numpy as np
import numpy.typing as npt

from depthcli.core.bands import row_bands
from depthcli.core.camera_ranges import EXPOSURE, WHITE_LEVEL
from depthcli.errors import UsageError
from depthcli.io.pictures.size import NETPBM
from depthcli.io.pictures.tiff import TIFF_STARTS, tiff_bits

_BITMAPS, _PLAIN = (b"P1", b"P4"), (b"P2", b"P3")
_CONFIGURATION = re.compile(rb"av1C\x81.(.)", re.DOTALL)
_HIGH, _TWELVE = 0x40, 0x20
_MIN_BITS, _MAX_BITS = 8, 16  # between them, TIFF is packed
_MAX = {np.dtype(np.uint8): 0xFF, np.dtype(np.uint16): 0xFFFF}
_SENSOR_WHITES = {0x3FF: 10, 0xFFF: 12}
"""Bits of the data whose white this is."""
_CLIPPED_SHARE = 1e-4


def full_range(
    pixels: npt.NDArray[Any], data: bytes, white_level: int | None = None
) -> tuple[npt.NDArray[Any], tuple[str, ...]]:
    """Pixels scaled so that white is the maximum of their type.

    Args:
        pixels: as they were decoded, of any type.
        data: the file; empty for pixels of a program.
        white_level: value of white in 16-bit pixels, from 1 to 65535, unless the file itself
            states one below 65535; None for what it states.

    Returns:
        The pixels, and warnings about them, one line each.
    """
    top = _MAX.get(pixels.dtype)
    if top is None:
        return pixels, ()
    stated = _stated_white(data)
    if stated is not None and stated < top:
        is_scaled = pixels.itemsize == 1 and data.startswith(_PLAIN)  # by the decoder itself
        return (pixels if is_scaled else scaled(pixels, stated)), ()
    if pixels.dtype != np.uint16:
        return pixels, ()
    if white_level is None:
        return pixels, _white_warnings(pixels)
    return scaled(pixels, white_level), _clip_warnings(pixels, white_level)


def check_white_level(white_level: int | None) -> None:
    """Check the value of white.

    Raises:
        UsageError: it is not a whole number from 1 to 65535.
    """
    is_number = isinstance(white_level, int | np.integer)
    if white_level is not None and not (is_number and WHITE_LEVEL.holds(white_level)):
        raise UsageError(f"a white level of {white_level!r} is not {WHITE_LEVEL.what}")


def check_exposure(stops: float) -> None:
    """Check an exposure.

    Raises:
        UsageError: it is not a number from -20 to 20.
    """
    if not EXPOSURE.holds(stops):
        raise UsageError(f"an exposure of {stops!r} is not {EXPOSURE.what}")


def scaled(pixels: npt.NDArray[Any], white: int) -> npt.NDArray[Any]:
    """Pixels of 8 or 16 bits times their maximum over ``white``; larger ones become white."""
    top = _MAX[pixels.dtype]
    levels = np.rint(np.minimum(np.arange(top + 1), white) * top / white).astype(pixels.dtype)
    found = np.empty_like(pixels)
    height, width = pixels.shape[:2]
    for rows in row_bands(width, height):  # indexing takes several times the memory of the pixels
        found[rows] = levels[pixels[rows]]
    return found


def _stated_white(data: bytes) -> int | None:
    """The value of white in an AVIF, Netpbm or packed TIFF; None if it is that of its type."""
    if data.startswith(TIFF_STARTS):
        bits = tiff_bits(data)
        # The decoder shifts them to the left.
        return (1 << _MAX_BITS) - (1 << _MAX_BITS - bits) if _MIN_BITS < bits < _MAX_BITS else None
    if data[4:8] == b"ftyp":
        found = _CONFIGURATION.search(data)
        flags = found[1][0] if found else 0
        return None if not flags & _HIGH else 0xFFF if flags & _TWELVE else 0x3FF
    netpbm = NETPBM.match(data)
    has_white = netpbm and netpbm[3] and not data.startswith(_BITMAPS)
    return int(netpbm[3]) if netpbm and has_white else None


def _white_warnings(pixels: npt.NDArray[Any]) -> tuple[str, ...]:
    """A warning about 16-bit pixels that are clipped at the white of a sensor of 10 or 12 bits.

    Dark pictures do not end in a plateau at exactly this value, so they give none.
    """
    white = int(pixels.max())
    bits = _SENSOR_WHITES.get(white)
    if bits is None or np.count_nonzero(pixels == white) < _CLIPPED_SHARE * pixels.size:
        return ()
    bright = f"its brightest pixels are {white} of 65535, as in data of {bits} bits"
    return (f"{bright}; if that is white, give --white-level {white}",)


def _clip_warnings(pixels: npt.NDArray[Any], white_level: int) -> tuple[str, ...]:
    brightest = int(pixels.max())
    if brightest <= white_level:
        return ()
    return (
        f"has pixels up to {brightest}, above the white level of {white_level}; they are white",
    )
