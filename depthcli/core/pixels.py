"""Validation of pixel arrays."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from depthcli.errors import InputError

_GRAY_RANK, _COLOUR_RANK = 2, 3
_RGB = 3
_CHANNELS = (1, 3, 4)
# Colours out of gamut and resampling make some negatives; a picture in [-1, 1] has many.
_ROUNDING, _NEGATIVE_SHARE = 0.01, 0.1
_LIT_SHARE = 0.01  # a few bright pixels on black are highlights


def check_pixels(pixels: npt.NDArray[Any]) -> None:
    """Check that pixels are (H, W) gray or (H, W, 3) RGB; uint8, uint16, or float32 in [0, 1].

    Raises:
        InputError: another shape or type, or floats that are not in [0, 1].
    """
    if not isinstance(pixels, np.ndarray):
        raise InputError(f"pixels have to be an array of NumPy, not {type(pixels).__name__}")
    shape, dtype = pixels.shape, pixels.dtype
    if len(shape) == _COLOUR_RANK and shape[0] in _CHANNELS and shape[-1] not in _CHANNELS:
        raise InputError(f"pixels of shape {shape} have channels first; use np.moveaxis(a, 0, -1)")
    if len(shape) not in (_GRAY_RANK, _COLOUR_RANK) or shape[_GRAY_RANK:] not in ((), (_RGB,)):
        raise InputError(f"pixels of shape {shape} are not a picture; give (H, W) or (H, W, 3) RGB")
    if 0 in shape:
        raise InputError(f"pixels of shape {shape} are an empty picture")
    if dtype not in (np.uint8, np.uint16, np.float32):
        raise InputError(f"pixels have to be uint8, uint16 or float32, not {dtype}; convert them")
    if dtype == np.float32:
        _check_floats(pixels)


def _check_floats(pixels: npt.NDArray[np.float32]) -> None:
    low, high = float(pixels.min()), float(pixels.max())
    if not (math.isfinite(low) and math.isfinite(high)):
        raise InputError(
            "some float pixels are NaN or infinite; replace them, for example with np.nan_to_num"
        )
    if is_out_of_range(pixels, low, high):
        raise InputError(f"float pixels have to be in [0, 1], not {low:g} to {high:g}; scale them")


def is_out_of_range(pixels: npt.NDArray[np.float32], low: float, high: float) -> bool:
    """Whether a finite picture is in 0-255, in [-1, 1] or in another range than [0, 1].

    Highlights may be above 1, if they are less than half of what is not black.

    Args:
        pixels: of any shape.
        low: the least of them.
        high: the largest.
    """
    negative = pixels.size * _NEGATIVE_SHARE
    if low < -_ROUNDING and np.count_nonzero(pixels < -_ROUNDING) > negative:
        return True
    if high <= 1 + _ROUNDING:
        return False
    lit = max(float(np.count_nonzero(pixels > 0)), pixels.size * _LIT_SHARE)
    return bool(np.count_nonzero(pixels > 1 + _ROUNDING) * 2 > lit)
