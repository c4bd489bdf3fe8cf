"""The mapping of a network's raw output to depth, shared by training, export and inference."""

from enum import StrEnum
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt


class Transform(StrEnum):
    """Function from ``t = scale * raw + shift`` to depth."""

    LINEAR = "linear"
    """depth = t"""
    EXP = "exp"
    """depth = exp(t)"""
    RECIPROCAL = "reciprocal"
    """depth = 1 / t"""


class DepthCodec(NamedTuple):
    """Depth of a raw network output."""

    transform: Transform = Transform.LINEAR  #: the shape of the mapping
    scale: float = 1.0  #: factor on the raw output
    shift: float = 0.0  #: added after the factor

    @classmethod
    def linear_m(cls, max_m: float) -> Self:
        """Raw [-1, 1] to [0, max_m] metres, the paper's normalization."""
        return cls(Transform.LINEAR, max_m / 2, max_m / 2)

    @classmethod
    def log_m(cls, min_m: float, max_m: float) -> Self:
        """Raw [-1, 1] to [min_m, max_m] metres, evenly in log depth."""
        low, high = float(np.log(min_m)), float(np.log(max_m))
        return cls(Transform.EXP, (high - low) / 2, (high + low) / 2)

    def decode(self, raw: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Depth of a raw output; any shape, float32 in and out.

        A reciprocal of zero or less is infinitely far, hence ``inf``. NaN stays NaN.
        """
        t = raw * np.float32(self.scale) + np.float32(self.shift)
        match self.transform:
            case Transform.LINEAR:
                return t
            case Transform.EXP:
                with np.errstate(over="ignore"):
                    depth: npt.NDArray[np.float32] = np.exp(t)
                return depth
            case Transform.RECIPROCAL:
                with np.errstate(divide="ignore", over="ignore"):
                    return np.where(t <= 0, np.float32(np.inf), np.float32(1) / t)
