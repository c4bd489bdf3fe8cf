"""Limits of a picture's size, and an estimate of the memory that its depth takes."""

import math
from typing import NamedTuple

from depthcli.core.bands import BAND_PIXELS
from depthcli.core.choices import DEFAULT_DETAIL, DEPTH_BYTES, Detail
from depthcli.errors import InputError

# All temporary arrays of a band of rows, as found by counting them in the code, and a margin.
_BYTES_A_BAND_PIXEL = 64
_COLOUR_BYTES = 3
_UNITS = (("G", 1_000_000_000), ("M", 1_000_000), ("K", 1_000))


class PictureLimit(NamedTuple):
    """The limits that a picture is checked against before it is decoded."""

    pixels: int  #: maximum number of pixels (``--max-pixels``)
    detail: Detail = DEFAULT_DETAIL  #: contains the memory limit (``--max-memory``)

    @classmethod
    def of(cls, pixels: "int | PictureLimit") -> "PictureLimit":
        """A limit of its number of pixels, or the limit itself."""
        return cls(pixels) if isinstance(pixels, int) else pixels

    def check(self, name: str, width: int, height: int, pixel_bytes: int = 1) -> None:
        """Refuse a picture by the size that its header claims.

        Args:
            name: what messages call it.
            width: columns.
            height: rows.
            pixel_bytes: least size of a pixel in memory while it is decoded.

        Raises:
            InputError: it has too many pixels, or takes too much memory even with so few bytes.
        """
        count = width * height
        if count > self.pixels:
            raise InputError(
                f"{name} claims {width}×{height} pixels, more than {self.pixels:,}; "
                "raise --max-pixels if you trust the file"
            )
        least = bytes_needed(width, height, self.detail, pixel_bytes * count)
        if least > memory_limit(self.detail):
            likely = max(pixel_bytes, _COLOUR_BYTES) * count
            about = bytes_needed(width, height, self.detail, likely)
            raise InputError(f"{name}: {memory_limit_message(width, height, about, self.detail)}")


def memory_limit(detail: Detail) -> float:
    """Most bytes for one picture; infinite without a limit."""
    return math.inf if detail.max_memory_bytes is None else detail.max_memory_bytes


def bytes_needed(
    width: int, height: int, detail: Detail, picture_bytes: int, input_bytes: int = 0
) -> int:
    """Memory of a picture without tiles: its pixels, a band of rows, and its input or its depth.

    ``input_bytes`` is the size of the arrays that the network's input is made of, at the picture's
    size; they are freed before depth is upsampled, so only the larger of both counts.
    """
    count = width * height
    band = min(count, max(BAND_PIXELS, width)) * _BYTES_A_BAND_PIXEL
    larger = max(input_bytes, (DEPTH_BYTES + detail.use_bytes) * count)
    return picture_bytes + larger + band  # the memory of bands is not freed at once


def memory_limit_message(width: int, height: int, needed: int, detail: Detail) -> str:
    """A message that the limit of memory is too low for a picture, with the memory it needs."""
    return (
        f"{width}×{height} pixels need {megabytes(needed)}, more than --max-memory "
        f"{size_text(memory_limit(detail))}; raise it to {megabytes(needed)} or make the picture "
        "smaller"
    )


def megabytes(count: float) -> str:
    """A number of bytes in the form of ``--max-memory``, rounded up: ``15M``."""
    return f"{math.ceil(count / 1_000_000)}M"


def size_text(count: float) -> str:
    """A number of bytes as short as possible: ``10``, ``200K``, ``1.5G``."""
    for letter, size in _UNITS:
        if count >= size:
            return f"{count / size:g}{letter}"
    return f"{count:g}"
