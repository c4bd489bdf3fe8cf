"""Temporal smoothing of depth, and a measure of its flicker."""

import math

import numpy as np
import numpy.typing as npt

from depthcli.core.resize import resize_bilinear
from depthcli.core.temporal.changes import Change
from depthcli.core.types import DepthKind, DepthMap


def to_log(depth: DepthMap) -> npt.NDArray[np.float32]:
    """The logarithm of metres, whose differences mean the same near and far.

    Values without a unit are returned as they are. (H, W) float32, NaN where there is no depth.
    """
    if depth.kind is not DepthKind.METRIC:
        return depth.values
    with np.errstate(divide="ignore", invalid="ignore"):
        logs: npt.NDArray[np.float32] = np.log(depth.values)
    return np.where(np.isfinite(logs), logs, np.float32(np.nan))


def from_log(values: npt.NDArray[np.float32], kind: DepthKind) -> npt.NDArray[np.float32]:
    """Inverse of :func:`to_log`; (H, W) float32 in and out."""
    return np.exp(values) if kind is DepthKind.METRIC else values


def ema_decay(interval_s: float, time_constant_s: float) -> float:
    """Decay of an exponential moving average: exp(-interval / time constant); 0 if that is 0."""
    return math.exp(-interval_s / time_constant_s) if time_constant_s > 0 else 0.0


class Smoother:
    """An exponential moving average of log depth that does not smear moving objects.

    The weight of the past is ``decay * static_weight``: less where the picture changes, none where
    it changes much, and none at a cut.
    """

    def __init__(self) -> None:
        self._before: npt.NDArray[np.float32] | None = None

    def step(
        self, values: npt.NDArray[np.float32], change: Change, decay: float
    ) -> npt.NDArray[np.float32]:
        """Smooth the next frame.

        Args:
            values: (H, W) float32 of :func:`to_log`.
            change: of the picture against the one before.
            decay: weight of the past where nothing moves, 0 to 1; see :func:`ema_decay`.

        Returns:
            (H, W) float32; NaN where ``values`` are NaN.
        """
        before = self._before
        if before is None or change.is_cut or before.shape != values.shape:
            self._before = values
            return values
        share = resize_bilinear(change.static_weight, values.shape[1], values.shape[0])
        correction = (before - values) * share * np.float32(decay)
        correction[np.isnan(correction)] = 0  # nothing before, or nothing now
        self._before = values + correction
        return self._before


class FlickerMeter:
    """How much depth changes from frame to frame where the picture hardly changes.

    The value is the mean absolute change of log depth against the frame before, over all pixels
    whose brightness changed by less than 2 % and all frames but the first of each scene: 0.01 is a
    change of one percent a frame. The change of values without a unit is divided by the range of
    the frame instead.
    """

    def __init__(self, kind: DepthKind) -> None:
        self._kind = kind
        self._before: npt.NDArray[np.float32] | None = None
        self._sum = 0.0
        self._count = 0

    def step(self, values: npt.NDArray[np.float32], change: Change) -> None:
        """Add a frame: (h, w) float32 of :func:`to_log`, at the size of the thumbnail."""
        before, self._before = self._before, values
        if before is None or change.is_cut:
            return
        changed = np.abs(values - before)[change.is_static] / self._unit(values)
        changed = changed[np.isfinite(changed)]
        self._sum += float(changed.sum(dtype=np.float64))
        self._count += changed.size

    def _unit(self, values: npt.NDArray[np.float32]) -> np.float32:
        """The divisor of changes."""
        finite = values[np.isfinite(values)]
        if self._kind is DepthKind.METRIC or not finite.size:
            return np.float32(1)
        return np.float32(finite.max() - finite.min() or 1)

    @property
    def value(self) -> float | None:
        """The value so far; None if no pixel could be compared."""
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
