"""Large images in overlapping tiles, each fitted to a pass over the whole image.

A network sees a tile at a higher resolution, but without its surroundings, so its depth has another
scale, which also drifts. Each tile is fitted to the whole image's depth by scale and shift, the
low-frequency part of the remaining difference is subtracted, and overlapping tiles are blended.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import NamedTuple, Self

import cv2
import numpy as np

from depthcli.core.arrays import Float32Array
from depthcli.core.imageops import resize_area, resize_bilinear
from depthcli.core.types import Frame
from depthcli.inference.transforms import blends_in_log, in_range
from depthcli.models.card import OutputSpec

_OVERLAP_SHARE = 0.25
# Sigma of the Gaussian that gives a tile's drift, as a share of its longer side.
_DRIFT_SIGMA_SHARE = 0.1
# Weight of a scale of one, which matters where the whole image's map is flat.
_PRIOR_WEIGHT = 0.01


class TileGrid(NamedTuple):
    """The tiles of an image, in cells, which are pixels of the coarse map."""

    width: int  #: columns of the whole map
    height: int  #: rows of the whole map
    tiles: tuple[tuple[slice, slice], ...]  #: (rows, columns) of each, from the top left

    @classmethod
    def plan(cls, frame_width: int, tile_px: int, coarse_shape: tuple[int, ...]) -> Self:
        """Tiles with the image's own aspect, so that the network's input has the same shape.

        Widths are in the image's pixels; ``coarse_shape`` is that of the network's depth.
        """
        zoom = frame_width / tile_px
        height, width = (round(length * zoom) for length in coarse_shape)
        down, across = (
            [slice(start, start + tile) for start in _starts(size, tile)]
            for size, tile in zip((height, width), coarse_shape, strict=True)
        )
        return cls(width, height, tuple(product(down, across)))


def refine(
    spec: OutputSpec,
    overall: Float32Array,
    frame: Frame,
    tile_px: int,
    predict: Callable[[Frame], Float32Array],
) -> Float32Array:
    """A finer map of an image, from tiles.

    Tiles are fitted and blended in log depth if the model is metric, else in its own values. The
    result is finer than ``overall``, (h, w) float32 of the whole image, by the ratio of the
    image's width to ``tile_px``; it is ``overall`` itself if that has holes. ``predict`` gives
    the depth of a tile at the network's size.
    """
    if not np.isfinite(overall).all():
        return overall
    grid = TileGrid.plan(frame.width, tile_px, overall.shape)
    if not blends_in_log(spec):
        return _blend_tiles(overall, frame, grid, predict)
    whole = np.log(in_range(spec, overall))
    blended = _blend_tiles(whole, frame, grid, lambda tile: np.log(in_range(spec, predict(tile))))
    return np.exp(blended)


def _blend_tiles(
    overall: Float32Array, frame: Frame, grid: TileGrid, predict: Callable[[Frame], Float32Array]
) -> Float32Array:
    """(grid.height, grid.width); tiles are added in a fixed order, so that rounding is too."""
    whole = resize_bilinear(overall, grid.width, grid.height)
    tile_size, size = overall.shape[::-1], (grid.width, grid.height)
    small = tuple(max(1, round(n * n / m)) for n, m in zip(tile_size, size, strict=True))
    # They increase smoothly from the tile's border to its middle, and are never 0.
    down, across = (np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2 for n in overall.shape)
    weights = np.asarray(np.outer(down, across) + 1e-6, np.float32)
    total, weight = np.zeros_like(whole), np.zeros_like(whole)
    for tile in grid.tiles:
        depth = resize_bilinear(predict(_cropped(frame, grid, tile)), *tile_size)
        # A tile with holes is replaced by the whole image's map.
        good = np.isfinite(depth).all()
        total[tile] += weights * (_fit_tile(depth, whole[tile], small) if good else whole[tile])
        weight[tile] += weights
    return total / weight


def _starts(size: int, tile: int) -> list[int]:
    """First cells of tiles that overlap by at least a quarter if they can, evenly spread."""
    step = max(1, tile - max(1, round(tile * _OVERLAP_SHARE)))
    count = 1 + math.ceil((size - tile) / step)
    return [round(start) for start in np.linspace(0, size - tile, count)]


def _cropped(frame: Frame, grid: TileGrid, tile: tuple[slice, slice]) -> Frame:
    rows = _pixels_of(tile[0], frame.height, grid.height)
    columns = _pixels_of(tile[1], frame.width, grid.width)
    pixels = frame.pixels[rows, columns]
    # A frame may have highlights, a tile of nothing else may not.
    return replace(frame, pixels=pixels.clip(0, 1) if pixels.dtype == np.float32 else pixels)


def _pixels_of(part: slice, size: int, cells: int) -> slice:
    """The pixels of some cells along an axis of the image, at least one."""
    start = min(round(part.start * size / cells), size - 1)
    return slice(start, max(start + 1, round(part.stop * size / cells)))


def _fit_tile(depth: Float32Array, coarse: Float32Array, small: tuple[int, ...]) -> Float32Array:
    """A tile's map fitted to the whole image's by least squares, with its drift removed.

    The scale is fitted at the size ``small``, (columns, rows) of the whole image's map before it
    was enlarged, because detail of the tile alone would bias it.
    """
    mean_found, mean_wanted = depth.mean(dtype=np.float64), coarse.mean(dtype=np.float64)
    x = resize_area(depth, *small) - mean_found
    y = resize_area(coarse, *small) - mean_wanted
    prior = _PRIOR_WEIGHT * float(depth.var(dtype=np.float64))
    spread = float((x * x).mean()) + prior
    # If a tile contradicts the whole image, its detail is not used.
    scale = max(0.0, (float((x * y).mean()) + prior) / spread) if spread > 0 else 1.0
    aligned = np.asarray(scale * (depth - mean_found) + mean_wanted, np.float32)
    sigma = _DRIFT_SIGMA_SHARE * max(depth.shape)
    drift = cv2.GaussianBlur(coarse - aligned, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    return aligned + drift
