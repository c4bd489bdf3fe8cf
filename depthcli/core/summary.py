"""The range of a depth map."""

from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from depthcli.core.types import DepthMap

_STEP = 64


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


def flat_warnings(depth: DepthMap) -> tuple[str, ...]:
    """A warning about a map whose pixels all have the same depth; none for other maps."""
    values, first = depth.values, depth.values[0, 0]
    # A few pixels tell it of nearly all maps.
    if (
        values.size == 1
        or (values[::_STEP, ::_STEP] != first).any()
        or values.min() != values.max()
    ):
        return ()
    where = f"{first:.6g} m" if depth.is_metric else f"{first:.6g}"
    advice = "if other pictures give the same, the scale or the range in the model's card is wrong"
    return (f"all pixels have the same depth, {where}; {advice}",)


def _median(values: npt.NDArray[np.float32]) -> float:
    """As np.median, which would import numpy.ma and take as long as writing a PNG."""
    middle = (values.size - 1) // 2, values.size // 2
    parted = np.partition(values, middle)
    return float((parted[middle[0]] + parted[middle[1]]) / 2)
