"""Temporal smoothing of depth, and a measure of its flicker."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.arrays import BoolArray, Float32Array
from depthcli.core.imageops import luma, resize_area, resize_bilinear
from depthcli.core.types import DepthKind, DepthMap

THUMBNAIL_PX = 192
_BLUR_PX = 5
_MOVING_DIFFERENCE = 0.06
_STATIC_DIFFERENCE = 0.02
_CUT_MIN_DIFFERENCE = 0.08
_CUT_RATIO = 3.0
_CUT_DECAY = 0.8


@dataclass(frozen=True, slots=True)
class Change:
    """Difference of an image from the one before."""

    #: (h, w) float32 in [0, 1], of brightness averaged over 5×5 pixels of the thumbnail, against
    #: noise
    difference: Float32Array
    is_cut: bool  #: whether a new scene begins

    @property
    def static_weight(self) -> Float32Array:
        """(h, w) float32: 1 where nothing moves, 0 where brightness changes by 6 % or more.

        The largest change in the 3×3 neighbourhood counts, since depth changes around a moving
        edge before brightness does.
        """
        largest = cv2.dilate(self.difference, np.ones((3, 3), np.uint8))
        return np.asarray(1 - np.clip(largest / np.float32(_MOVING_DIFFERENCE), 0, 1))

    @property
    def is_static(self) -> BoolArray:
        """(h, w): where brightness changes by less than 2 %."""
        return self.difference < _STATIC_DIFFERENCE


class ChangeDetector:
    """Compares each picture of a video with the one before.

    It is a cut if the mean change is at least 8 % of full brightness and at least three times the
    running mean of the changes in this scene.
    """

    def __init__(self) -> None:
        self._blurred: Float32Array | None = None
        self._mean_change = 0.0

    def step(self, thumbnail: Float32Array) -> Change:
        """The change to the next picture's :func:`thumbnail`; the first picture is a cut."""
        blurred = np.asarray(
            cv2.blur(thumbnail, (_BLUR_PX, _BLUR_PX), borderType=cv2.BORDER_REPLICATE), np.float32
        )
        before, self._blurred = self._blurred, blurred
        if before is None or before.shape != blurred.shape:
            return Change(np.ones_like(blurred), is_cut=True)
        difference = np.abs(blurred - before)
        mean = float(difference.mean())
        is_cut = mean >= max(_CUT_MIN_DIFFERENCE, _CUT_RATIO * self._mean_change)
        running = _CUT_DECAY * self._mean_change + (1 - _CUT_DECAY) * mean
        self._mean_change = 0.0 if is_cut else running
        return Change(difference, is_cut)


def thumbnail(pixels: npt.NDArray[np.generic]) -> Float32Array:
    """A picture's luma, its long side at most 192 pixels; (h, w) float32 in [0, 1]."""
    height, width = pixels.shape[:2]
    scale = min(1.0, THUMBNAIL_PX / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return luma(resize_area(np.asarray(pixels), *size))


def to_log(depth: DepthMap) -> Float32Array:
    """The logarithm of metres, whose differences mean the same near and far.

    Values without a unit are returned as they are. (H, W) float32, NaN where there is no depth.
    """
    if depth.kind is not DepthKind.METRIC:
        return depth.values
    with np.errstate(divide="ignore", invalid="ignore"):
        logs: Float32Array = np.log(depth.values)
    return np.where(np.isfinite(logs), logs, np.float32(np.nan))


def from_log(values: Float32Array, kind: DepthKind) -> Float32Array:
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
        self._before: Float32Array | None = None

    def step(self, values: Float32Array, change: Change, decay: float) -> Float32Array:
        """Smooth the next frame, (H, W) float32 of :func:`to_log`; NaN stays NaN.

        ``decay`` is the weight of the past where nothing moves; see :func:`ema_decay`.
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
    """Measures how much depth changes from frame to frame where the picture hardly changes.

    The value is the mean absolute change of log depth against the frame before, over all pixels
    whose brightness changed by less than 2 % and all frames but the first of each scene: 0.01 is a
    change of one percent a frame. The change of values without a unit is divided by the range of
    the frame instead.
    """

    def __init__(self, kind: DepthKind) -> None:
        self._kind = kind
        self._before: Float32Array | None = None
        self._sum = 0.0
        self._count = 0

    def step(self, values: Float32Array, change: Change) -> None:
        """Add a frame: (h, w) float32 of :func:`to_log`, at the size of the thumbnail."""
        before, self._before = self._before, values
        if before is None or change.is_cut:
            return
        finite, unit = values[np.isfinite(values)], np.float32(1)
        if self._kind is not DepthKind.METRIC and finite.size:
            unit = np.float32(finite.max() - finite.min() or 1)
        changed = np.abs(values - before)[change.is_static] / unit
        changed = changed[np.isfinite(changed)]
        self._sum += float(changed.sum(dtype=np.float64))
        self._count += changed.size

    @property
    def value(self) -> float | None:
        """The value so far; None if no pixel could be compared."""
        return self._sum / self._count if self._count else None


def sample_cells(values: Float32Array, shape: tuple[int, ...]) -> Float32Array:
    """The values at the middle of each cell of a coarser grid; (H, W) to ``shape``, float32."""
    rows, columns = (
        ((np.arange(n) + 0.5) * size / n).astype(int)
        for n, size in zip(shape, values.shape, strict=True)
    )
    return np.asarray(values[rows[:, np.newaxis], columns])


class RangeLock:
    """The two ends of a colour range, each an exponential moving average.

    Without it every frame would be stretched to its own percentiles, and one near object passing
    by would change the colour of everything else. Positive ends are averaged as logarithms.
    """

    def __init__(self) -> None:
        self._ends: tuple[float, float] | None = None

    def step(
        self, low: float, high: float, decay: float, *, is_cut: bool = False
    ) -> tuple[float, float]:
        """The smoothed ends of the next frame; a cut drops the past, else its weight is decay."""
        if self._ends is None or is_cut:
            self._ends = (low, high)
        else:
            before_low, before_high = self._ends
            low = _weighted_mean(before_low, low, decay)
            self._ends = low, _weighted_mean(before_high, high, decay)
        return self._ends


def _weighted_mean(before: float, now: float, decay: float) -> float:
    if before > 0 and now > 0:
        return math.exp(decay * math.log(before) + (1 - decay) * math.log(now))
    return decay * before + (1 - decay) * now
