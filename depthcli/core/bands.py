"""Processing large pictures a few rows at a time, so that no whole copy of them is in memory."""

from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt

from depthcli.core.resize import resize_area

BAND_PIXELS = 100_000
"""Pixels of a band: its few float arrays fit a processor's L2 cache."""


def row_bands(width: int, height: int) -> Iterator[slice]:
    """Rows of a picture from top to bottom, about :data:`BAND_PIXELS` pixels at a time."""
    count = max(1, BAND_PIXELS // width)
    for top in range(0, height, count):
        yield slice(top, min(top + count, height))


def shrink_bands(
    pixels: npt.NDArray[np.generic],
    plane: Callable[[npt.NDArray[np.generic]], npt.NDArray[np.float32]],
    width: int,
    height: int,
) -> npt.NDArray[np.float32]:
    """What ``resize_area(plane(pixels), width, height)`` returns, up to rounding.

    Args:
        pixels: (H, W) or (H, W, 3), of a frame.
        plane: a pointwise function of pixels, such as those of :mod:`depthcli.core.colour`.
        width: of the result.
        height: of the result.

    Returns:
        (height, width) or (height, width, C) float32.
    """
    rows, columns = pixels.shape[:2]
    narrowest = min(width, columns)  # a strip is widened once it is short
    narrow = [
        resize_area(plane(pixels[band]), narrowest, band.stop - band.start)
        for band in row_bands(columns, rows)
    ]
    return resize_area(np.concatenate(narrow), width, height)
