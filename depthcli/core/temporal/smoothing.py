"""Depth over time: smoothing it, and measuring how it flickers."""

import math

import numpy as np
import numpy.typing as npt

from depthcli.core.resize import resize_bilinear
from depthcli.core.temporal.changes import Change
from depthcli.core.types import DepthKind, DepthMap


def to_steps(depth: DepthMap) -> npt.NDArray[np.float32]:
    """Values whose differences mean the same near and far: the logarithm of metres.

    Values without a unit stay as they are. (H, W) float32, NaN where there is no depth.
    """
    if depth.kind is not DepthKind.METRIC:
        return depth.values
    with np.errstate(divide="ignore", invalid="ignore"):
        logs: npt.NDArray[np.float32] = np.log(depth.values)
    return np.where(np.isfinite(logs), logs, np.float32(np.nan))


def from_steps(steps: npt.NDArray[np.float32], kind: DepthKind) -> npt.NDArray[np.float32]:
    """Inverse of :func:`to_steps`; (H, W) float32 in and out."""
    return np.exp(steps) if kind is DepthKind.METRIC else steps


def kept_share(interval_s: float, time_constant_s: float) -> float:
    """Share of the past in an exponential mean: exp(-interval / time constant); 0 without one."""
    return math.exp(-interval_s / time_constant_s) if time_constant_s > 0 else 0.0


class Smoother:
    """An exponential mean of log depth over time that moving things do not smear.

    The past's share is ``kept * stillness``: less where the picture changes, none where it
    changes much, and none at a cut.
    """

    def __init__(self) -> None:
        self._before: npt.NDArray[np.float32] | None = None

    def step(
        self, values: npt.NDArray[np.float32], change: Change, kept: float
    ) -> npt.NDArray[np.float32]:
        """The smoothed values (H, W) float32 of the next frame, both as of :func:`to_steps`.

        NaN where there is no depth stays so. ``kept``, of :func:`kept_share`, is the past's share
        where nothing moves, 0 to 1.
        """
        before = self._before
        if before is None or change.is_cut or before.shape != values.shape:
            self._before = values
            return values
        share = resize_bilinear(change.stillness, values.shape[1], values.shape[0])
        pull = (before - values) * share * np.float32(kept)
        pull[np.isnan(pull)] = 0  # nothing before, or nothing now
        self._before = values + pull
        return self._before


class FlickerMeter:
    """How much depth changes from frame to frame where the picture hardly does.

    The figure is the mean absolute change of log depth against the frame before, over all pixels
    whose brightness changed by less than 2 %, over all frames but the first of each scene: 0.01 is
    a change of one percent a frame. Of values without a unit, the change is divided by the range
    of the frame in place of the logarithm.
    """

    def __init__(self, kind: DepthKind) -> None:
        self._kind = kind
        self._before: npt.NDArray[np.float32] | None = None
        self._sum = 0.0
        self._count = 0

    def step(self, values: npt.NDArray[np.float32], change: Change) -> None:
        """Count a frame: (h, w) float32 of :func:`to_steps`, at the size of the guide."""
        before, self._before = self._before, values
        if before is None or change.is_cut:
            return
        changed = np.abs(values - before)[change.is_still] / self._unit(values)
        changed = changed[np.isfinite(changed)]
        self._sum += float(changed.sum(dtype=np.float64))
        self._count += changed.size

    def _unit(self, values: npt.NDArray[np.float32]) -> np.float32:
        """What a change is measured in."""
        finite = values[np.isfinite(values)]
        if self._kind is DepthKind.METRIC or not finite.size:
            return np.float32(1)
        return np.float32(finite.max() - finite.min() or 1)

    @property
    def value(self) -> float | None:
        """The figure so far; None if no pixel could be compared."""
        return self._sum / self._count if self._count else None


def sample_cells(
    values: npt.NDArray[np.float32], shape: tuple[int, ...]
) -> npt.NDArray[np.float32]:
    """The values at the middle of each cell of a coarser grid; (H, W) to ``shape``, float32."""
    rows, columns = (
        ((np.arange(n) + 0.5) * size / n).astype(int)
        for n, size in zip(shape, values.shape, strict=True)
    )
    sampled: npt.NDArray[np.float32] = values[rows[:, np.newaxis], columns]
    return sampled
