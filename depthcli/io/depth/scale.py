"""Depth as 16-bit integers, and the scale of such integers in a file."""

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from depthcli.core.arrays import BoolArray, Float32Array, FloatArray
from depthcli.core.imageops import row_bands
from depthcli.core.types import has_depth
from depthcli.errors import UsageError
from depthcli.io.depth.metadata import positive_number
from depthcli.io.formats.table import MILLIMETRES

UINT16_MAX = 65535
NORMALIZED = ("normalized", "inverse")  #: scales of integers that span the range of (1/)depth
_UNITS = {1: "m", 100: "cm", MILLIMETRES: "mm"}


class DepthScale(NamedTuple):
    """The scale of the numbers in a depth file."""

    units_per_metre: float  #: 1000 for millimetres
    source: Literal["file", "option", "assumed"]  #: who states it

    @property
    def text(self) -> str:
        """Unit and source, for tables: ``mm, assumed``."""
        source = {"file": "stated", "option": "given", "assumed": "assumed"}[self.source]
        unit = _UNITS.get(self.units_per_metre, f"1/{self.units_per_metre:g} m")
        return f"{unit}, {source}"


def check_units_per_metre(scale: float) -> None:
    """Check a number of units per metre."""
    if not 0 < scale < math.inf:
        raise UsageError(f"a scale of {scale:g} units per metre is not a number above 0")


def depth_scale(
    metadata: Mapping[str, str],
    option: float | None,
    unstated: float | None = None,
    *,
    is_integer: bool = True,
    has_unit: bool = True,
) -> DepthScale | None:
    """Scale of the numbers in a file; None if they are normalized or have no unit.

    It is that of the option, else what the metadata state, else ``unstated``, else millimetres in
    integers and metres in floats, if there is a unit even if none is stated.
    """
    if option is None and metadata.get("scale") in NORMALIZED:
        return None
    for given in (option, unstated):
        if given is not None:
            check_units_per_metre(given)
    stated = positive_number(metadata.get("scale"))
    if stated is None and not is_integer and has_unit and "software" in metadata:
        stated = 1.0  # depthcli wrote it
    if option is not None:
        return DepthScale(option, "option")
    if stated is not None:
        return DepthScale(stated, "file")
    if unstated is not None:
        return DepthScale(unstated, "option")
    return DepthScale(MILLIMETRES if is_integer else 1.0, "assumed") if has_unit else None


def quantized(values: Float32Array, scale: float) -> tuple[npt.NDArray[np.uint16], int]:
    """Metres, (H, W), as 16-bit integers of ``scale`` units per metre, rounded to nearest.

    They are 0 where there is no depth, 1 to 65535 elsewhere; with the number of pixels beyond.
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


def dequantized(steps: npt.NDArray[np.generic], scale: float) -> Float32Array:
    """Metres of integers of ``scale`` units per metre: (H, W) in, float32 out, NaN where 0."""
    values = steps.astype(np.float32) / np.float32(scale)
    return np.where(steps == 0, np.float32(np.nan), values)


def normalized(
    values: FloatArray, known: BoolArray, low: float, high: float
) -> npt.NDArray[np.uint16]:
    """Values from ``low`` to ``high`` as 1-65535, clamped; 0 where they are not known."""
    share = (np.where(known, values, low) - low) / ((high - low) or 1.0)
    steps = np.rint(1 + np.clip(share, 0, 1) * (UINT16_MAX - 1))
    return np.where(known, steps, 0).astype(np.uint16)


def denormalized(steps: npt.NDArray[np.generic], low: float, high: float) -> Float32Array:
    """Values from ``low`` to ``high`` of 1-65535: (H, W) in, float32 out, NaN where they are 0."""
    share = (steps.astype(np.float64) - 1) / (UINT16_MAX - 1)
    values = (low + share * (high - low)).astype(np.float32)
    return np.where(steps == 0, np.float32(np.nan), values)
