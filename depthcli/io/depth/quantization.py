"""Quantization of depth to 16-bit integers."""

import math

import numpy as np
import numpy.typing as npt

from depthcli.core.imageops import row_bands
from depthcli.core.types import has_depth
from depthcli.errors import UsageError

UINT16_MAX = 65535


def check_units_per_metre(scale: float) -> None:
    """Check a number of units per metre.

    Raises:
        UsageError: it is not a number above 0.
    """
    if not 0 < scale < math.inf:
        raise UsageError(f"a scale of {scale:g} units per metre is not a number above 0")


def quantized(values: npt.NDArray[np.float32], scale: float) -> tuple[npt.NDArray[np.uint16], int]:
    """Depth as 16-bit integers, and how many pixels are saturated.

    Args:
        values: (H, W) float32 metres.
        scale: units per metre.

    Returns:
        (H, W) uint16, rounded to nearest: 0 where there is no depth, at least 1 and at most 65535
        elsewhere; and the number of pixels at 65535 or beyond.

    Raises:
        UsageError: the scale is not a number above 0.
    """
    check_units_per_metre(scale)
    height, width = values.shape
    steps = np.empty((height, width), np.uint16)
    saturated = 0
    for rows in row_bands(width, height):
        band, known = values[rows] * np.float32(scale), has_depth(values[rows])
        np.rint(band, out=band)
        saturated += int(np.count_nonzero(known & (band >= UINT16_MAX)))
        np.clip(band, 1, UINT16_MAX, out=band)
        band[~known] = 0
        steps[rows] = band
    return steps, saturated


def dequantized(steps: npt.NDArray[np.generic], scale: float) -> npt.NDArray[np.float32]:
    """Metres of integers of ``scale`` units per metre: (H, W) in, float32 out, NaN where 0."""
    values = steps.astype(np.float32) / np.float32(scale)
    return np.where(steps == 0, np.float32(np.nan), values)


def normalized(
    values: npt.NDArray[np.floating], known: npt.NDArray[np.bool_], low: float, high: float
) -> npt.NDArray[np.uint16]:
    """Values from ``low`` to ``high`` as 1-65535, clamped; 0 where they are not known.

    Any shape in, the same out. It is computed in the precision of ``values``.
    """
    share = (np.where(known, values, low) - low) / ((high - low) or 1.0)
    steps = np.rint(1 + np.clip(share, 0, 1) * (UINT16_MAX - 1))
    return np.where(known, steps, 0).astype(np.uint16)


def denormalized(
    steps: npt.NDArray[np.generic], low: float, high: float
) -> npt.NDArray[np.float32]:
    """Values from ``low`` to ``high`` of 1-65535: (H, W) in, float32 out, NaN where they are 0."""
    share = (steps.astype(np.float64) - 1) / (UINT16_MAX - 1)
    values = (low + share * (high - low)).astype(np.float32)
    return np.where(steps == 0, np.float32(np.nan), values)
