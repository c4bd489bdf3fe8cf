"""How large a picture may be, and how much memory it takes on its way to depth."""

import math
from typing import NamedTuple

from depthcli.core.bands import BAND_PIXELS
from depthcli.core.choices import DEPTH_BYTES, PLAIN, Detail
from depthcli.errors import InputError

# Counted in the code, with some to spare: planes of one band.
_BYTES_A_BAND_PIXEL = 64
_COLOUR_BYTES = 3
_UNITS = (("G", 1_000_000_000), ("M", 1_000_000), ("K", 1_000))


class PictureLimit(NamedTuple):
    """What is known to be too large before it is decoded."""

    pixels: int  #: most pixels; ``--max-pixels`` sets it
    detail: Detail = PLAIN  #: its limit of memory, ``--max-memory``, holds as well

    def check(self, name: str, width: int, height: int) -> None:
        """Refuse a picture by the size that its header claims.

        Raises:
            InputError: it has too many pixels, or even in gray takes too much memory.
        """
        count = width * height
        if count > self.pixels:
            raise InputError(
                f"{name} claims {width}×{height} pixels, more than {self.pixels:,}; "
                "raise --max-pixels if it is genuine"
            )
        if bytes_needed(width, height, self.detail, count) > memory_limit(self.detail):
            about = bytes_needed(width, height, self.detail, _COLOUR_BYTES * count)
            raise InputError(f"{name}: {too_little(width, height, about, self.detail)}")


def memory_limit(detail: Detail) -> float:
    """Most bytes for one picture; infinite without a limit."""
    return math.inf if detail.max_memory_bytes is None else detail.max_memory_bytes


def bytes_needed(
    width: int, height: int, detail: Detail, picture_bytes: int, input_bytes: int = 0
) -> int:
    """What a picture takes without tiles: its pixels, a band, and the most of what comes in turn.

    ``input_bytes`` is what becomes the network's input, at the picture's size.
    """
    count = width * height
    band = min(count, max(BAND_PIXELS, width)) * _BYTES_A_BAND_PIXEL
    then = max(input_bytes, (DEPTH_BYTES + detail.use_bytes) * count)
    # What bands took is not given back at once.
    return picture_bytes + then + band


def too_little(width: int, height: int, needed: int, detail: Detail) -> str:
    """That the limit is too low for a picture, and what it would have to be."""
    return (
        f"{width}×{height} pixels need {megabytes(needed)}, more than --max-memory "
        f"{size_text(memory_limit(detail))}; raise it to {megabytes(needed)} or make the picture "
        "smaller"
    )


def megabytes(count: float) -> str:
    """So many bytes as ``--max-memory`` takes them, rounded up: ``15M``."""
    return f"{math.ceil(count / 1_000_000)}M"


def size_text(count: float) -> str:
    """A limit as it was given: ``10``, ``200K``, ``1.5G``."""
    for letter, size in _UNITS:
        if count >= size:
            return f"{count / size:g}{letter}"
    return f"{count:g}"
