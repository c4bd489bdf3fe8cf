"""Encoding PNG files, faster and smaller than OpenCV does; see docs/performance.md."""

import struct
import zlib
from collections.abc import Callable, Mapping
from functools import partial
from itertools import chain

import numpy as np
import numpy.typing as npt

from depthcli.errors import OutputError
from depthcli.io.png.chunks import MAX_LENGTH, SIGNATURE, chunk, text_chunk

Compressor = Callable[[npt.NDArray[np.uint8]], bytes | bytearray]

_GRAY, _RGB = 0, 2  # colour types of the header
# Depth changes little from row to row: of the five filters this one is fastest and leaves least.
_FILTER_UP = 2
# Higher levels gain a tenth of the size for twice the time.
_LEVEL = 1


def encode_png(
    pixels: npt.NDArray[np.uint8] | npt.NDArray[np.uint16], texts: Mapping[str, str] | None = None
) -> bytes:
    """A PNG file of gray (H, W) or RGB (H, W, 3); the same pixels and texts give the same bytes.

    Texts, keyword -> text, are as for :func:`text_chunk`. Filtering and compression release the
    GIL.

    Raises:
        OutputError: there are no pixels, or more than PNG allows.
    """
    height, width = pixels.shape[:2]
    if not (0 < height <= MAX_LENGTH and 0 < width <= MAX_LENGTH):
        raise OutputError(f"pixels of shape {pixels.shape} do not go into a PNG; use EXR or NPY")
    colour = _GRAY if pixels.ndim == 2 else _RGB  # noqa: PLR2004
    header = struct.pack(">IIBBBBB", width, height, 8 * pixels.itemsize, colour, 0, 0, 0)
    data = memoryview(_compress(_filtered(pixels)))
    chunks = [
        chunk(b"IHDR", header),
        *(text_chunk(keyword, text) for keyword, text in (texts or {}).items()),
        *(chunk(b"IDAT", data[at : at + MAX_LENGTH]) for at in range(0, len(data), MAX_LENGTH)),
        chunk(b"IEND", b""),
    ]
    return b"".join((SIGNATURE, *chain.from_iterable(chunks)))


def _filtered(pixels: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]) -> npt.NDArray[np.uint8]:
    """Rows filtered with type Up: the filter's number, then the differences to the row above."""
    big_endian = np.ascontiguousarray(pixels, pixels.dtype.newbyteorder(">"))
    rows = big_endian.reshape(len(pixels), -1).view(np.uint8)
    filtered = np.empty((rows.shape[0], rows.shape[1] + 1), np.uint8)
    filtered[:, 0] = _FILTER_UP
    filtered[0, 1:] = rows[0]  # above the first row is zero
    np.subtract(rows[1:], rows[:-1], out=filtered[1:, 1:])
    return filtered


def _compressor() -> Compressor:
    """The compressor of libdeflate if there is a build for this machine, else Python's zlib.

    Both give valid files with the same pixels; libdeflate takes half the time.
    """
    try:
        from deflate import zlib_compress  # noqa: PLC0415 - may be missing
    except ImportError:
        return partial(zlib.compress, level=_LEVEL)
    return partial(zlib_compress, compresslevel=_LEVEL)


_compress = _compressor()
