"""Depth as 16-bit integers, and the scale of such integers in a file."""

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from depthcli.core.imageops import row_bands
from depthcli.core.types import has_depth
from depthcli.errors import UsageError
from depthcli.io.depth.metadata import positive_number
from depthcli.io.formats.table import MILLIMETRES

UINT16_MAX = 65535


class DepthScale(NamedTuple):
    """The scale of depth that is stored as integers."""

    units_per_metre: float  #: 1000 for millimetres
    source: Literal["file", "option", "assumed"]  #: who states it


def check_units_per_metre(scale: float) -> None:
    """Check a number of units per metre.

    Raises:
        UsageError: it is not a number above 0.
    """
    if not 0 < scale < math.inf:
        raise UsageError(f"a scale of {scale:g} units per metre is not a number above 0")


def depth_scale(
    metadata: Mapping[str, str], option: float | None, unstated: float | None = None
) -> DepthScale | None:
    """Scale of the integers in a file; None if they are normalized.

    Args:
        metadata: metadata of the file.
        option: units per metre that the user states; None for what the file states.
        unstated: units per metre of a file that states none; None for millimetres.

    Raises:
        UsageError: the option is not a number above 0.
    """
    if option is not None:
        check_units_per_metre(option)
        return DepthScale(option, "option")
    if metadata.get("scale") == "normalized":
        return None
    stated = positive_number(metadata.get("scale"))
    if stated is not None:
        return DepthScale(stated, "file")
    assumed = DepthScale(MILLIMETRES, "assumed")
    return assumed if unstated is None else DepthScale(unstated, "option")


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
