"""Depth that follows known points locally: what a global fit leaves is spread over the image.

The errors of a network are smooth within a surface and change at its edges. The logarithm of the
ratio of known to fitted depth is therefore interpolated over column, row and log depth, from coarse
to fine, and a point that contradicts its neighbours has no effect.

Source: Barnes: A technique for maximizing details in numerical weather map analysis. Journal of
Applied Meteorology 3, 1964 (successive corrections); Chen, Paris, Durand: Real-time edge-aware
image processing with the bilateral grid. SIGGRAPH 2007.
"""

import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

_Values = npt.NDArray[np.float64]

# All constants were chosen on held-out pairs; docs/known-depth.md has the errors.
_SCALES = tuple(0.4 / 2**level for level in range(7))  # standard deviations, in widths of the image
_SURFACE, _LEAST_SURFACE = 0.3, 0.1  # those of log depth, at the coarsest scale and at the finest
_STIFFNESS = 0.3  # weight of no correction, in points
_STIFFER = 12.0  # how much of it is added where all points are wrong
_NEIGHBOURS = 0.3  # points near half of the points, from which a scale is used
_PASSES = 3

_EDGES = 0.02  # share of right points beside an edge, where the error is anything
_FREEDOM = 5.0
_LEAST_SD = 0.02
_RANGE = 3.0  # of the logarithm of a wrong ratio
_PRIOR_WRONG, _PRIOR_POINTS = 0.5, 40.0
_FAR, _FEW = 0.3, 0.04  # points are suspicious if more than this share is this far from the others
_ITERATIONS = 20

_TAPS = np.exp(-0.5 * np.arange(-4, 5) ** 2.0)
_BESIDE = float(_TAPS[5])
# Mean weight of a point at itself, after it is spread over its cell and read from it again.
_SELF = (2 / 3 + _BESIDE / 3) ** 3
_CORNERS = np.array(list(np.ndindex(2, 2, 2)))[:, :, None]


class _Level:
    """One scale: points are spread over its nodes, and read from them.

    Nodes are one standard deviation of the weights apart; those of columns and rows are the middles
    of equal cells of the image.
    """

    def __init__(self, scale: float, at: _Values, aspect: float, low: float, high: float) -> None:
        """Weights of the eight nodes around each point.

        ``at`` is (3, N): log depth, from ``low`` to ``high`` in the map, row and column; these, the
        scale and the aspect (the height) are in widths of the image.
        """
        self.depth_step = max(_LEAST_SURFACE, _SURFACE * math.sqrt(scale / _SCALES[0]))
        depths = math.ceil((high - low) / self.depth_step) + 2
        rows, columns = max(1, round(aspect / scale)), max(1, round(1 / scale))
        self.nodes = depths, rows, columns
        last = np.array(self.nodes)[:, None] - 1
        depth = (at[0] - low) / self.depth_step
        place = np.stack([depth, at[1] * rows / aspect - 0.5, at[2] * columns - 0.5]).clip(0, last)
        node = np.minimum(place.astype(np.int64), np.maximum(last - 1, 0))
        part = place - node
        corners = np.minimum(node + _CORNERS, last)  # (8, 3, N)
        self._index = (corners[:, 0] * rows + corners[:, 1]) * columns + corners[:, 2]
        self._weight = np.where(_CORNERS, part, 1 - part).prod(axis=1)
        own: _Values = (1 - part) ** 2 + part**2 + 2 * part * (1 - part) * _BESIDE
        self.own = own.prod(axis=0) / _SELF

    def spread(self, values: _Values) -> _Values:
        """Sum of (N,) values at each node, weighted by distance: (depths, rows, columns)."""
        weighted = (self._weight * values).ravel()
        summed: Any = np.bincount(self._index.ravel(), weighted, math.prod(self.nodes))
        summed = summed.astype(np.float32)  # filtered in half the time
        for size in self.nodes[::-1]:  # each axis in turn is the last
            flat = summed.reshape(-1, size)
            flat = cv2.sepFilter2D(flat, -1, _TAPS, np.ones(1), borderType=cv2.BORDER_CONSTANT)
            summed = np.ascontiguousarray(flat.T)
        total: _Values = summed.reshape(self.nodes) / _SELF
        return total

    def read(self, field: _Values) -> _Values:
        """Values of a field at the points: (N,)."""
        total: _Values = (self._weight * field.ravel()[self._index]).sum(axis=0)
        return total

    def layer(self, field: _Values, depth: float, size: tuple[int, int]) -> _Values:
        """A field at one log depth above the least, for (columns, rows): (rows, columns)."""
        place = min(depth / self.depth_step, self.nodes[0] - 1.0)
        node = min(int(place), self.nodes[0] - 2)
        mixed = field[node] * (node + 1 - place) + field[node + 1] * (place - node)
        resized: Any = cv2.resize(mixed, size, interpolation=cv2.INTER_LINEAR)
        return np.asarray(resized, np.float64)


def spread_log_ratio(
    log_ratio: _Values,
    x: npt.NDArray[np.int64],
    y: npt.NDArray[np.int64],
    depth_m: npt.NDArray[np.float32],
    trusted: npt.NDArray[np.bool_],
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """Interpolate what points say about a map over the map.

    Args:
        log_ratio: (N,) natural logarithm of known over mapped depth.
        x: (N,) columns.
        y: (N,) rows.
        depth_m: (H, W) metres; NaN where there is none, but not at the points.
        trusted: (N,) whether a point is right at first sight.

    Returns:
        The logarithm of the correction of each pixel: (H, W), 0 far from all points; and which
        points it follows: (N,) bool.
    """
    height, width = depth_m.shape
    log_depth = np.log(depth_m, where=depth_m > 0, out=np.full_like(depth_m, np.nan))
    at = np.stack([log_depth[y, x], (y + 0.5) / width, (x + 0.5) / width], dtype=np.float64)
    low, high = float(np.nanmin(log_depth)), float(np.nanmax(log_depth))
    levels = [_Level(scale, at, height / width, low, high) for scale in _SCALES]
    weights = trusted.astype(np.float64)
    levels = _with_neighbours(levels, weights)
    for step in range(_PASSES):
        error = _left_out_errors(levels, log_ratio, weights)
        if step == 0:
            far = float((np.abs(error) > _FAR).mean())
            doubt = np.where(trusted, 1.0, min(1.0, (_FEW / max(far, _FEW)) ** 2))
        weights = _weights(error, doubt)
    followed = weights > 0.5  # noqa: PLR2004 - right rather than wrong
    weights *= followed
    stiffness = _STIFFNESS * (1 + _STIFFER * float(1 - weights.mean()))
    fields, left = [], log_ratio
    for level in levels:
        field = level.spread(weights * left) / (level.spread(weights) + stiffness)
        fields.append(field)
        left = left - level.read(field)
    return _sliced(levels, fields, log_depth), followed


def _with_neighbours(levels: list[_Level], weights: _Values) -> list[_Level]:
    """The levels at which at least half of the points have a neighbour."""
    kept = levels[:1]
    for level in levels[1:]:
        others = level.read(level.spread(weights)) - weights * level.own
        if np.median(others) < _NEIGHBOURS:
            break
        kept.append(level)
    return kept


def _left_out_errors(levels: list[_Level], log_ratio: _Values, weights: _Values) -> _Values:
    """Distance of each point from what the others say of it: (N,)."""
    left = error = log_ratio
    for level in levels:
        weighted, total = level.spread(weights * left), level.spread(weights)
        own = weights * level.own
        others = level.read(total) - own
        error = left - (level.read(weighted) - own * left) / (np.maximum(others, 0) + _STIFFNESS)
        left = left - level.read(weighted / (total + _STIFFNESS))
    return error


def _weights(error: _Values, doubt: _Values) -> _Values:
    """Probability that each point is right: (N,), by expectation maximization.

    Errors of right points have Student's distribution, but for a few beside edges.
    """
    sd = max(float(np.median(np.abs(error))) / 0.75, _LEAST_SD)
    wrong, right = 0.05, np.ones_like(error)
    for _ in range(_ITERATIONS):
        inner = (1 - _EDGES) * _student(error / sd) / sd
        likely = doubt * (1 - wrong) * (inner + _EDGES / _RANGE)
        right = likely / (likely + wrong / _RANGE)
        surface = right * inner / (inner + _EDGES / _RANGE)
        heavy = surface * (_FREEDOM + 1) / (_FREEDOM + (error / sd) ** 2)
        sd = max(math.sqrt(float((heavy * error**2).sum() / surface.sum())), _LEAST_SD)
        wrong = (float((1 - right).sum()) + _PRIOR_WRONG) / (len(error) + _PRIOR_POINTS)
    return right


def _student(error: _Values) -> _Values:
    """Density of Student's distribution with five degrees of freedom."""
    scale = math.gamma((_FREEDOM + 1) / 2) / math.gamma(_FREEDOM / 2)
    density = (1 + error**2 / _FREEDOM) ** (-(_FREEDOM + 1) / 2)
    return scale / math.sqrt(_FREEDOM * math.pi) * density


def _sliced(
    levels: list[_Level], fields: list[_Values], log_depth: npt.NDArray[np.float32]
) -> npt.NDArray[np.float32]:
    """Sum of the fields at each pixel: (H, W), 0 where there is no depth."""
    finest = levels[-1]
    depths, rows, columns = finest.nodes
    low = np.nanmin(log_depth)
    place = np.nan_to_num((log_depth - low) / np.float32(finest.depth_step), nan=-2.0)
    result, share = np.zeros_like(log_depth), np.empty_like(log_depth)
    for depth in range(depths):
        at = depth * finest.depth_step
        each = [lv.layer(f, at, (columns, rows)) for lv, f in zip(levels, fields, strict=True)]
        layer = cv2.resize(np.sum(each, axis=0, dtype=np.float32), log_depth.shape[::-1])
        share = np.abs(np.subtract(place, depth, out=share), out=share)
        share = np.maximum(np.subtract(1, share, out=share), 0, out=share)
        result += np.multiply(layer, share, out=share)
    return result
