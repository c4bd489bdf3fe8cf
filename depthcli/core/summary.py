"""The range of a depth map."""

from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from depthcli.core.types import DepthMap


class DepthRange(NamedTuple):
    """Least, median and largest depth, in the map's unit; None where it has no depth at all."""

    min: float | None
    median: float | None
    max: float | None

    @classmethod
    def of(cls, depth: DepthMap) -> Self:
        """The range of a depth map where it has depth."""
        known = depth.values[depth.valid]
        if not known.size:
            return cls(None, None, None)
        return cls(float(known.min()), _median(known), float(known.max()))


def _median(values: npt.NDArray[np.float32]) -> float:
    """As np.median, which would import numpy.ma and take as long as writing a PNG."""
    middle = (values.size - 1) // 2, values.size // 2
    parted = np.partition(values, middle)
    return float((parted[middle[0]] + parted[middle[1]]) / 2)
