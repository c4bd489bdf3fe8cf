"""Scaling pixels of AVIF and Netpbm whose white is below the maximum of their type."""

import re
from typing import Any

import numpy as np
import numpy.typing as npt

from depthcli.io.pictures.size import NETPBM

_BITMAPS, _PLAIN = (b"P1", b"P4"), (b"P2", b"P3")
_CONFIGURATION = re.compile(rb"av1C\x81.(.)", re.DOTALL)
_HIGH, _TWELVE = 0x40, 0x20


def full_range(pixels: npt.NDArray[Any], data: bytes) -> npt.NDArray[Any]:
    """Pixels scaled so that white is the maximum of their type.

    Args:
        pixels: as they were decoded, of any type.
        data: the file.
    """
    if pixels.dtype not in (np.uint8, np.uint16):
        return pixels
    top, white = (1 << 8 * pixels.itemsize) - 1, _white(data)
    if white is None or white >= top or (pixels.itemsize == 1 and data.startswith(_PLAIN)):
        return pixels  # the decoder scales 8-bit plain Netpbm itself
    levels = np.rint(np.minimum(np.arange(top + 1), white) * top / white).astype(pixels.dtype)
    return levels.take(pixels)


def _white(data: bytes) -> int | None:
    """The value of white in a file; None if it is the maximum of its type."""
    if data[4:8] == b"ftyp":
        found = _CONFIGURATION.search(data)
        flags = found[1][0] if found else 0
        return None if not flags & _HIGH else 0xFFF if flags & _TWELVE else 0x3FF
    netpbm = NETPBM.match(data)
    has_white = netpbm and netpbm[3] and not data.startswith(_BITMAPS)
    return int(netpbm[3]) if netpbm and has_white else None
