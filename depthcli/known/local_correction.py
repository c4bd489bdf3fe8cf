"""Depth that follows known points locally: what a global fit leaves is spread over the image.

The errors of a network are smooth within a surface and change at its edges. The logarithm of the
ratio of known to fitted depth is therefore interpolated over column, row and log depth, from coarse
to fine, and a point that contradicts its neighbours has no effect.

Source: Barnes: A technique for maximizing details in numerical weather map analysis. Journal of
Applied Meteorology 3, 1964 (successive corrections); Chen, Paris, Durand: Real-time edge-aware
image processing with the bilateral grid. SIGGRAPH 2007.
"""

import math
from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

_Values = npt.NDArray[np.float64]
_Field = npt.NDArray[np.float32]

# All constants were chosen on held-out pairs; docs/known-depth.md has the errors.
_SCALES = tuple(0.4 / 2**level for level in range(7))  # standard deviations, in widths of the image
_SURFACE, _LEAST_SURFACE = 0.3, 0.1  # those of log depth, at the coarsest scale and at the finest
_STIFFNESS = 0.3  # weight of no correction, in points
_STIFFER = 12.0  # how much of it is added where all points are wrong
_NEIGHBOURS = 0.3  # points near half of the points, from which a scale is used

# Share of right points whose error is anything: those whose depth the map has around them, as
# beside an edge, and others.
_AT_EDGES, _ELSEWHERE = 0.1, 0.005
_AROUND, _ALIKE = 0.02, 0.15  # how far around, in widths of the image, and of how much log depth
_FREEDOM = 5.0  # of Student's distribution, whose density is _STUDENT at 0
_STUDENT = 8 / (3 * math.pi * math.sqrt(_FREEDOM))
_LEAST_SD = 0.02
_RANGE = 3.0  # of the logarithm of a wrong ratio
_PRIOR_WRONG, _PRIOR_POINTS = 0.5, 40.0
_FAR, _FEW = 0.3, 0.02  # points are suspicious if more than this share is this far from the others
_ITERATIONS = 8
_MOST = 30_000  # points; OpenCV samples images at fewer than 32,767

_TAPS = np.exp(-0.5 * np.arange(-4, 5) ** 2.0)
_BESIDE = float(_TAPS[5])
# Mean weight of a point at itself, after it is spread over its cell and read from it again.
_SELF = (2 / 3 + _BESIDE / 3) ** 3
_CORNERS = np.array(list(np.ndindex(2, 2, 2)))[:, :, None]
_MOST_DEPTHS = 100  # nodes; OpenCV filters images of up to 128 channels


class _Level:
    """One scale: points are spread over its nodes, and read from them.

    Nodes are one standard deviation of the weights apart; those of columns and rows are the middles
    of equal cells of the image.
    """

    def __init__(self, scale: float, at: _Values, aspect: float, low: float, high: float) -> None:
        """Weights of the eight nodes around each point.

        ``at`` is (3, N): row and column as shares of the image, log depth from ``low`` to ``high``.
        The scale and the aspect (the height) are in widths of the image.
        """
        surface = max(_LEAST_SURFACE, _SURFACE * math.sqrt(scale / _SCALES[0]))
        self.depth_step = max(surface, (high - low) / _MOST_DEPTHS)
        rows, columns = max(1, round(aspect / scale)), max(1, round(1 / scale))
        depths = math.ceil((high - low) / self.depth_step) + 2
        self.nodes = rows, columns, depths
        last = np.array(self.nodes)[:, None] - 1
        depth = (at[2] - low) / self.depth_step
        place = np.stack([at[0] * rows - 0.5, at[1] * columns - 0.5, depth]).clip(0, last)
        node = np.minimum(place.astype(np.int64), np.maximum(last - 1, 0))
        part = place - node
        corners = np.minimum(node + _CORNERS, last)  # (8, 3, N)
        self._index = (corners[:, 0] * columns + corners[:, 1]) * depths + corners[:, 2]
        self._weight = np.where(_CORNERS, part, 1 - part).prod(axis=1)
        self_weight: _Values = (1 - part) ** 2 + part**2 + 2 * part * (1 - part) * _BESIDE
        self.self_weight = self_weight.prod(axis=0) / _SELF

    def spread(self, values: _Values) -> _Field:
        """Sum of (N,) values at each node, weighted by distance: (rows, columns, depths)."""
        weighted = (self._weight * values).ravel() / _SELF
        summed: Any = np.bincount(self._index.ravel(), weighted, math.prod(self.nodes))
        summed = summed.astype(np.float32).reshape(self.nodes)  # filtered in half the time
        summed = cv2.sepFilter2D(summed, -1, _TAPS, _TAPS, borderType=cv2.BORDER_CONSTANT)
        summed = summed.reshape(-1, self.nodes[2])
        summed = cv2.sepFilter2D(summed, -1, _TAPS, np.ones(1), borderType=cv2.BORDER_CONSTANT)
        return np.asarray(summed.reshape(self.nodes))

    def read(self, field: _Field) -> _Values:
        """Values of a field at the points: (N,)."""
        total: _Values = (self._weight * field.ravel()[self._index]).sum(axis=0)
        return total

    def resized(self, field: _Field, depth_step: float) -> _Field:
        """A field of another scale, whose nodes are a step of log depth apart, at these nodes."""
        last = field.shape[2] - 1
        place = np.minimum(np.arange(self.nodes[2]) * self.depth_step / depth_step, last)
        weight = np.maximum(1 - np.abs(place - np.arange(last + 1)[:, None]), 0)
        depths = cv2.resize(field @ weight.astype(np.float32), self.nodes[1::-1])
        return np.asarray(depths.reshape(self.nodes))


def log_correction(
    log_depth: _Field,
    at: _Values,
    known_m: _Values,
    followed: npt.NDArray[np.bool_],
    passes: int = 3,
) -> _Field:
    """Logarithm of the correction by which a map follows points.

    Args:
        log_depth: (H, W) float32 logarithm of mapped depth; NaN where there is none.
        at: (3, N) rows and columns as shares of the image, and logarithm of mapped depth.
        known_m: (N,) depth of the points.
        followed: (N,) which points are right at first sight; then, in place, which it follows.
        passes: how often a point is judged by the others.

    Returns:
        (H, W), NaN where there is no depth, and near 0 far from all points.
    """
    some = thinned(np.isfinite(at[2]))
    at, trusted = at[:, some], followed[some]
    log_ratio = np.log(known_m[some]) - at[2]
    low, high = float(np.nanmin(log_depth)), float(np.nanmax(log_depth))
    aspect = log_depth.shape[0] / log_depth.shape[1]
    levels: Iterable[_Level] = (_Level(scale, at, aspect, low, high) for scale in _SCALES)
    weights = trusted.astype(np.float64)
    nearest, farthest = _around(log_depth, at)
    for step in range(passes):
        error, levels = _left_out_errors(levels, log_ratio, weights)
        if step == 0:
            far = float((np.abs(error) > _FAR).mean())
            doubt = np.where(trusted, 1.0, min(1.0, (_FEW / max(far, _FEW)) ** 2))
        is_around = (error > nearest - _ALIKE) & (error < farthest + _ALIKE)
        weights = _weights(error, doubt, np.where(is_around, _AT_EDGES, _ELSEWHERE))
    followed[some] = weights > 0.5  # noqa: PLR2004 - right rather than wrong
    weights *= followed[some]
    stiffness = _STIFFNESS * (1 + _STIFFER * float(1 - weights.mean()))
    field, depth_step = np.zeros((1, 1, 1), np.float32), 1.0
    for level in levels:
        field = level.resized(field, depth_step)
        left = log_ratio - level.read(field)
        field += level.spread(weights * left) / (level.spread(weights) + stiffness)
        depth_step = level.depth_step
    return _sliced(field, (log_depth - np.float32(low)) / np.float32(depth_step))


def thinned(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """Where a mask (N,) is true, at most 30,000 places, evenly spaced in their order."""
    some = np.flatnonzero(mask)
    return some[:: 1 + len(some) // _MOST]


def _left_out_errors(
    levels: Iterable[_Level], log_ratio: _Values, weights: _Values
) -> tuple[_Values, list[_Level]]:
    """Distance of each point from what the others say of it, (N,), and the levels that say it.

    At these, but for the first, at least half of the points have a neighbour.
    """
    left = error = log_ratio
    used = list[_Level]()
    for level in levels:
        total, self_weights = level.spread(weights), weights * level.self_weight
        others = level.read(total) - self_weights
        if used and np.median(others) < _NEIGHBOURS:
            break
        weighted = level.spread(weights * left)
        error = left - (level.read(weighted) - self_weights * left) / (
            np.maximum(others, 0) + _STIFFNESS
        )
        left = left - level.read(weighted / (total + _STIFFNESS))
        used.append(level)
    return error, used


def _around(log_depth: _Field, at: _Values) -> tuple[_Values, _Values]:
    """Least and largest log depth of the map around each point, from that at the point: (N,)."""
    rows, columns = (
        np.minimum((at[axis] * size).astype(np.int64), size - 1)
        for axis, size in enumerate(log_depth.shape)
    )
    side = 2 * max(1, round(_AROUND * log_depth.shape[1])) + 1
    window, is_hole = np.ones((side, side), np.uint8), np.isnan(log_depth)
    least = cv2.erode(np.where(is_hole, np.float32(np.inf), log_depth), window)
    most = cv2.dilate(np.where(is_hole, np.float32(-np.inf), log_depth), window)
    return least[rows, columns] - at[2], most[rows, columns] - at[2]


def _weights(error: _Values, doubt: _Values, anything: _Values) -> _Values:
    """Probability that each point is right: (N,), by expectation maximization.

    Errors of right points have Student's distribution, but for a share of ``anything``: (N,).
    """
    sd = max(float(np.median(np.abs(error))) / 0.75, _LEAST_SD)
    wrong, right = 0.05, np.ones_like(error)
    for _ in range(_ITERATIONS):
        spread = 1 + (error / sd) ** 2 / _FREEDOM
        inner = (1 - anything) * _STUDENT / sd / (spread * spread * spread)  # ** 3 is much slower
        likely = doubt * (1 - wrong) * (inner + anything / _RANGE)
        right = likely / (likely + wrong / _RANGE)
        surface = right * inner / (inner + anything / _RANGE)
        heavy = surface * (1 + 1 / _FREEDOM) / spread
        sd = max(math.sqrt(float((heavy * error**2).sum() / surface.sum())), _LEAST_SD)
        wrong = (float((1 - right).sum()) + _PRIOR_WRONG) / (len(error) + _PRIOR_POINTS)
    return right


def _sliced(field: _Field, depth: _Field) -> _Field:
    """A field at each pixel, whose log depth is (H, W) in steps from the first node: (H, W)."""
    layers, size = np.ascontiguousarray(field.transpose(2, 0, 1)), depth.shape[::-1]
    result, share = cv2.resize(layers[0], size), np.empty_like(depth)
    for node, change in enumerate(np.diff(layers, axis=0)):
        share = np.clip(np.subtract(depth, node, out=share), 0, 1, out=share)
        result += np.multiply(cv2.resize(change, size), share, out=share)
    return np.asarray(result)
