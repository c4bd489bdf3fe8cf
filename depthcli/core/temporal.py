"""Temporal smoothing of depth, and a measure of its flicker."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core import imageops, types

THUMBNAIL_PX = 192
_BLUR_PX = 5
_MOVING_DIFFERENCE = 0.06
_STATIC_DIFFERENCE = 0.02
_CUT_MIN_DIFFERENCE = 0.08
_CUT_RATIO = 3.0
_CUT_DECAY = 0.8
_CELL_PX = 3  # thumbnail pixels of a cell of the correction; also the Gaussian's σ
_MOVING_SHARE = np.float32(0.6)  # of a change of brightness that flow leaves; of noise nearly all
_NO_CHANGE = np.float32(1e-7)
_REPEAT = cv2.BORDER_REPLICATE
_MAX_PAST = 60  # frames that count without look-ahead
_MIN_FLOW_PX = 32  # OpenCV's optical flow reads beyond the memory of smaller images
_MIN_SHARE = 0.02  # of a cell's surroundings that has depth before and now


@dataclass(frozen=True, slots=True)
class Change:
    """Difference of an image from the one before."""

    #: (h, w) float32 in [0, 1], of brightness averaged over 5×5 pixels of the thumbnail, against
    #: noise
    difference: types.Float32Array
    is_cut: bool  #: whether a new scene begins

    @property
    def static_weight(self) -> types.Float32Array:
        """(h, w) float32: 1 where nothing moves, 0 where brightness changes by 6 % or more.

        The largest change in the 3×3 neighbourhood counts, since depth changes around a moving
        edge before brightness does.
        """
        largest = cv2.dilate(self.difference, np.ones((3, 3), np.uint8))
        return np.asarray(1 - np.clip(largest / np.float32(_MOVING_DIFFERENCE), 0, 1))


class ChangeDetector:
    """Compares each image of a video with the one before.

    It is a cut if the mean change is at least 8 % of full brightness and at least three times the
    running mean of the changes in this scene.
    """

    def __init__(self) -> None:
        self._blurred: types.Float32Array | None = None
        self._mean_change = 0.0

    def step(self, thumbnail: types.Float32Array) -> Change:
        """The change to the next image's :func:`thumbnail`; the first image is a cut."""
        blurred = _blurred(thumbnail)
        before, self._blurred = self._blurred, blurred
        if before is None or before.shape != blurred.shape:
            return Change(np.ones_like(blurred), is_cut=True)
        difference = np.abs(blurred - before)
        mean = float(difference.mean())
        is_cut = mean >= max(_CUT_MIN_DIFFERENCE, _CUT_RATIO * self._mean_change)
        running = _CUT_DECAY * self._mean_change + (1 - _CUT_DECAY) * mean
        self._mean_change = 0.0 if is_cut else running
        return Change(difference, is_cut)


def thumbnail(pixels: npt.NDArray[np.generic]) -> types.Float32Array:
    """An image's luma, its long side at most 192 pixels; (h, w) float32 in [0, 1]."""
    height, width = pixels.shape[:2]
    scale = min(1.0, THUMBNAIL_PX / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return imageops.luma(imageops.resize_area(np.asarray(pixels), *size))


def _blurred(thumbnail: types.Float32Array) -> types.Float32Array:
    return np.asarray(cv2.blur(thumbnail, (_BLUR_PX, _BLUR_PX), borderType=_REPEAT), np.float32)


def to_log(depth: types.DepthMap) -> types.Float32Array:
    """The logarithm of metres, whose differences mean the same near and far.

    Values without a unit are returned as they are. (H, W) float32, NaN where there is no depth.
    """
    if depth.kind is not types.DepthKind.METRIC:
        return depth.values
    return np.log(np.where(depth.valid, depth.values, np.float32(np.nan)))


def from_log(values: types.Float32Array, kind: types.DepthKind) -> types.Float32Array:
    """Inverse of :func:`to_log`; (H, W) float32 in and out."""
    return np.exp(values) if kind is types.DepthKind.METRIC else values


def ema_decay(interval_s: float, time_constant_s: float) -> float:
    """Decay of an exponential moving average: exp(-interval / time constant); 0 if that is 0."""
    return math.exp(-interval_s / time_constant_s) if time_constant_s > 0 else 0.0


class Correction(NamedTuple):
    """Values that steady one frame, on a grid with cells of 3×3 pixels of the thumbnail."""

    rise: types.Float32Array  #: (rows, columns) float32, to be added to its :func:`to_log`
    #: (rows, columns) float32: 1 where nothing moves, 0 where motion explains the change
    stillness: types.Float32Array


class _Link(NamedTuple):
    """The change from a frame to the next of its scene."""

    rise: types.Float32Array  # of depth before above depth now, along the motion
    stillness: types.Float32Array
    decay: float  # of weights, over the time between the two; 0 for the first frame


class Deflicker:
    """Takes the slow part of flicker out of depth, also where the image moves.

    A network's depth swells and shrinks by some percent from frame to frame, over large parts of
    the image. The change between neighbours is measured along the optical flow, averaged over
    some pixels of the thumbnail, and added up. Each frame is then moved to the mean of those around
    it in its scene, whose weights decay exponentially with time. Edges stay, as the correction is
    smooth. The mean reaches as far back as ahead, so that a steady change, as of a camera that
    comes nearer, stays; near the ends of a scene, it is that of a straight line. Without
    look-ahead, depth lags behind it.

    Source of the flow: Kroeger et al., "Fast Optical Flow using Dense Inverse Search", ECCV 2016.
    """

    def __init__(self, look_ahead: int) -> None:
        self._look_ahead = look_ahead
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
        self._before: tuple[types.Float32Array, types.Float32Array] | None = None
        self._past: deque[_Link] = deque(maxlen=look_ahead or _MAX_PAST)
        self._waiting: deque[_Link] = deque()

    def step(
        self,
        thumbnail: types.Float32Array,
        values: types.Float32Array,
        decay: float,
        *,
        is_cut: bool,
    ) -> list[Correction]:
        """Take the next frame; return what is now known of frames before it and of it, in order.

        Args:
            thumbnail: the image, (h, w) float32 in [0, 1].
            values: its :func:`to_log` of the same size, NaN where there is no depth.
            decay: of weights since the frame before; see :func:`ema_decay`.
            is_cut: whether a new scene begins.
        """
        done = self.finish() if is_cut else []
        image = _blurred(thumbnail)
        before, self._before = self._before, (image, values)
        if is_cut or before is None:
            rows, columns = (max(1, size // _CELL_PX) for size in thumbnail.shape)
            nothing = np.zeros((rows, columns), np.float32)
            link = _Link(nothing, nothing, 0.0)
        else:
            link = _Link(*self._change(*before, image, values), decay)
        self._waiting.append(link)
        if len(self._waiting) > self._look_ahead:
            done.append(self._oldest())
        return done

    def finish(self) -> list[Correction]:
        """Corrections of the frames that still wait for later ones, which do not come."""
        return [self._oldest() for _ in range(len(self._waiting))]

    def _oldest(self) -> Correction:
        now = self._waiting.popleft()
        self._past.append(now)
        has_trend = self._look_ahead > 0
        return Correction(_rise_to_trend(self._past, self._waiting, has_trend), now.stillness)

    def _change(
        self,
        image_before: types.Float32Array,
        before: types.Float32Array,
        image: types.Float32Array,
        values: types.Float32Array,
    ) -> tuple[types.Float32Array, types.Float32Array]:
        """Rise and stillness between two frames, on the grid."""
        height, width = values.shape
        x_px, y_px = self._motion(image_before, image)
        rows, columns = np.arange(height, dtype=np.float32), np.arange(width, dtype=np.float32)
        places = x_px + columns, y_px + rows[:, np.newaxis]
        there = cv2.remap(before, *places, cv2.INTER_LINEAR, borderValue=(math.nan,) * 4)
        rise = there - values
        is_known = np.isfinite(rise)
        still = image_before - image
        moved = cv2.remap(image_before, *places, cv2.INTER_LINEAR, borderMode=_REPEAT) - image
        fine = np.dstack([np.where(is_known, rise, 0), is_known, still * still, moved * moved])
        cells = max(1, width // _CELL_PX), max(1, height // _CELL_PX)
        coarse = cv2.GaussianBlur(
            imageops.resize_area(fine.astype(np.float32), *cells), (0, 0), 1.0, borderType=_REPEAT
        )
        total, share, still, moved = np.moveaxis(coarse, -1, 0)
        mean = total / np.maximum(share, np.float32(_MIN_SHARE))
        left = (moved + _NO_CHANGE) / (still + _NO_CHANGE)
        return mean, np.asarray(np.clip((left - _MOVING_SHARE) / (1 - _MOVING_SHARE), 0, 1))

    def _motion(
        self, before: types.Float32Array, image: types.Float32Array
    ) -> tuple[types.Float32Array, types.Float32Array]:
        """Columns and rows from each pixel to its place in the image before; 0 in small ones."""
        if min(image.shape) < _MIN_FLOW_PX:
            return np.zeros_like(image), np.zeros_like(image)
        now, then = (np.rint(each * 255).astype(np.uint8) for each in (image, before))
        flow = np.asarray(self._flow.calc(now, then, np.zeros((*image.shape, 2), np.float32)))
        return np.ascontiguousarray(flow[..., 0]), np.ascontiguousarray(flow[..., 1])


def _rise_to_trend(
    past: Sequence[_Link], future: Sequence[_Link], has_trend: bool
) -> types.Float32Array:
    """Rise of the mean of frames, or of a straight line through them, above the last one of past.

    Links lead from that one to those before it, and to those after it. A frame's weight is the
    product of decays on its way, and the logarithm of that its distance in time. The line is that
    of weighted least squares; the mean is the same where as many earlier as later frames count.
    """
    total, tilt = np.zeros_like(past[-1].rise), np.zeros_like(past[-1].rise)
    count, moment, square = 1.0, 0.0, 0.0  # this frame counts once
    for links, sign in ((reversed(past), 1), (future, -1)):
        weight, rise = 1.0, np.zeros_like(total)
        for link in links:
            weight *= link.decay
            if weight == 0:  # a scene begins
                break
            rise = rise + np.float32(sign) * link.rise
            away = sign * math.log(weight)
            count += weight
            moment += weight * away
            square += weight * away**2
            total += np.float32(weight) * rise
            tilt += np.float32(weight * away) * rise
    if has_trend and square:
        total = np.float32(square) * total - np.float32(moment) * tilt
        count = count * square - moment**2
    return np.asarray(total / np.float32(count), np.float32)


class Smoother:
    """An exponential moving average of log depth where nothing moves.

    The weight of the past is ``decay * static_weight * stillness``: less where the image changes
    or moves, none where it does so much, and none at a cut.
    """

    def __init__(self) -> None:
        self._before: types.Float32Array | None = None

    def step(
        self, values: types.Float32Array, change: Change, correction: Correction, decay: float
    ) -> types.Float32Array:
        """Steady and smooth the next frame, (H, W) float32 of :func:`to_log`; NaN stays NaN.

        ``decay`` is the weight of the past where nothing moves; see :func:`ema_decay`.
        """
        height, width = values.shape
        values = values + imageops.resize_bilinear(correction.rise, width, height)
        before = self._before
        if before is None or change.is_cut or before.shape != values.shape:
            self._before = values
            return values
        still = imageops.resize_bilinear(correction.stillness, *change.difference.shape[::-1])
        share = imageops.resize_bilinear(change.static_weight * still, width, height)
        rise = (before - values) * share * np.float32(decay)
        rise[np.isnan(rise)] = 0  # nothing before, or nothing now
        self._before = values + rise
        return self._before


class FlickerMeter:
    """Measures how much depth changes from frame to frame where the image hardly changes.

    The value is the mean absolute change of log depth against the frame before, over all pixels
    whose brightness changed by less than 2 % and all frames but the first of each scene: 0.01 is a
    change of one percent a frame. The change of values without a unit is divided by the range of
    the frame instead.
    """

    def __init__(self, kind: types.DepthKind) -> None:
        self._kind = kind
        self._before: types.Float32Array | None = None
        self._sum = 0.0
        self._count = 0

    def step(self, values: types.Float32Array, change: Change) -> None:
        """Add a frame: (h, w) float32 of :func:`to_log`, at the size of the thumbnail."""
        before, self._before = self._before, values
        if before is None or change.is_cut:
            return
        finite, unit = values[np.isfinite(values)], np.float32(1)
        if self._kind is not types.DepthKind.METRIC and finite.size:
            unit = np.float32(finite.max() - finite.min() or 1)
        changed = np.abs(values - before)[change.difference < _STATIC_DIFFERENCE] / unit
        changed = changed[np.isfinite(changed)]
        self._sum += float(changed.sum(dtype=np.float64))
        self._count += changed.size

    @property
    def value(self) -> float | None:
        """The value so far; None if no pixel could be compared."""
        return self._sum / self._count if self._count else None


def sample_cells(values: types.Float32Array, shape: tuple[int, ...]) -> types.Float32Array:
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
