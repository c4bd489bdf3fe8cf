"""Depth of an image from overlapping parts: tiles of a large one, and views of a panorama.

A network sees a tile at a higher resolution, but without its surroundings, so its depth has another
scale, which also drifts. Each tile is fitted to the whole image's depth by scale and shift, the
low-frequency part of the remaining difference is subtracted, and overlapping tiles are blended.

Each pinhole view of an equirectangular panorama is multiplied by one factor, so that they agree
best where they overlap, as in MoGe (Wang et al., arXiv:2410.19115), and they are blended in log
distance with weights that are 0 at their borders, so that there is no seam. Metres are those of the
level views, which are what a network learned; its own field of view suits it best, so there are 26
views in place of MoGe's twelve.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from typing import NamedTuple, Self

import cv2
import numpy as np

from depthcli.core import imageops, types
from depthcli.errors import InputError
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
    overall: types.Float32Array,
    frame: types.Frame,
    tile_px: int,
    predict: Callable[[types.Frame], types.Float32Array],
) -> types.Float32Array:
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
    overall: types.Float32Array,
    frame: types.Frame,
    grid: TileGrid,
    predict: Callable[[types.Frame], types.Float32Array],
) -> types.Float32Array:
    """(grid.height, grid.width); tiles are added in a fixed order, so that rounding is too."""
    whole = imageops.resize_bilinear(overall, grid.width, grid.height)
    tile_size, size = overall.shape[::-1], (grid.width, grid.height)
    small = tuple(max(1, round(n * n / m)) for n, m in zip(tile_size, size, strict=True))
    # They increase smoothly from the tile's border to its middle, and are never 0.
    down, across = (np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2 for n in overall.shape)
    weights = np.asarray(np.outer(down, across) + 1e-6, np.float32)
    total, weight = np.zeros_like(whole), np.zeros_like(whole)
    for tile in grid.tiles:
        depth = imageops.resize_bilinear(predict(_cropped(frame, grid, tile)), *tile_size)
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


def _cropped(frame: types.Frame, grid: TileGrid, tile: tuple[slice, slice]) -> types.Frame:
    rows = _pixels_of(tile[0], frame.height, grid.height)
    columns = _pixels_of(tile[1], frame.width, grid.width)
    pixels = frame.pixels[rows, columns]
    # A frame may have highlights, a tile of nothing else may not.
    return replace(frame, pixels=pixels.clip(0, 1) if pixels.dtype == np.float32 else pixels)


def _pixels_of(part: slice, size: int, cells: int) -> slice:
    """The pixels of some cells along an axis of the image, at least one."""
    start = min(round(part.start * size / cells), size - 1)
    return slice(start, max(start + 1, round(part.stop * size / cells)))


def _fit_tile(
    depth: types.Float32Array, coarse: types.Float32Array, small: tuple[int, ...]
) -> types.Float32Array:
    """A tile's map fitted to the whole image's by least squares, with its drift removed.

    The scale is fitted at the size ``small``, (columns, rows) of the whole image's map before it
    was enlarged, because detail of the tile alone would bias it.
    """
    mean_found, mean_wanted = depth.mean(dtype=np.float64), coarse.mean(dtype=np.float64)
    x = imageops.resize_area(depth, *small) - mean_found
    y = imageops.resize_area(coarse, *small) - mean_wanted
    prior = _PRIOR_WEIGHT * float(depth.var(dtype=np.float64))
    spread = float((x * x).mean()) + prior
    # If a tile contradicts the whole image, its detail is not used.
    scale = max(0.0, (float((x * y).mean()) + prior) / spread) if spread > 0 else 1.0
    aligned = np.asarray(scale * (depth - mean_found) + mean_wanted, np.float32)
    sigma = _DRIFT_SIGMA_SHARE * max(depth.shape)
    drift = cv2.GaussianBlur(coarse - aligned, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    return aligned + drift


HFOV_DEG = 65.0  #: field of view of a view, which is square
_HALF_VIEW = math.tan(math.radians(HFOV_DEG) / 2)  # half its width at a depth of 1
_MAX_VIEW_PX = 1024
_VIEWS_DEG = (
    *((yaw, 0.0) for yaw in range(0, 360, 45)),
    *((yaw + 22.5, pitch) for pitch in (45.0, -45.0) for yaw in range(0, 360, 45)),
    *((0.0, pitch) for pitch in (90.0, -90.0)),
)
"""(yaw to the right, pitch up) of each view; the first row of the image is at a pitch of 90°."""
_LEVEL_WEIGHT = 1e-6  # of factors of one of level views, as images of the training are
_FIT_PX = 256, 128  # pixels of the panorama at which factors are fitted


def panorama_distance(
    frame: types.Frame, predict: Callable[[types.Frame], types.Float32Array]
) -> types.Float32Array:
    """Distance along the ray of each pixel of an equirectangular image, (H, W) float32 metres.

    ``predict`` gives metres along the axis, (h, w) float32, of a view of :data:`HFOV_DEG`.
    """
    if abs(frame.width - 2 * frame.height) > 2:  # noqa: PLR2004
        size = f"{frame.width}×{frame.height}"
        problem = f"a panorama of all directions is twice as wide as high, not {size}"
        raise InputError(problem, "give {projection} pinhole, or the whole panorama")
    side = min(_MAX_VIEW_PX, max(8, round(frame.width / math.pi * _HALF_VIEW)))
    width = min(frame.width, round(side * math.pi / _HALF_VIEW))
    small = imageops.resize_area(frame.pixels, width, max(1, width // 2))  # type: ignore[arg-type]
    turns, logs, are_level = list[types.Float64Array](), list[types.Float32Array](), list[bool]()
    for yaw_deg, pitch_deg in _VIEWS_DEG:
        turn = _rotation(yaw_deg, pitch_deg)
        view = np.ascontiguousarray(_view(small, turn, side))
        log = np.log(predict(types.Frame(view)) * np.linalg.norm(_view_rays(side), axis=-1))
        if np.isfinite(log).all():
            turns.append(turn)
            logs.append(log)
            are_level.append(pitch_deg == 0)
    if not logs:
        raise InputError("no view of the panorama has depth everywhere")
    samples = [*_samples(types.panorama_rays(*_FIT_PX), turns, logs)]
    offsets = _offsets(samples, np.array(are_level))
    distance = np.empty((frame.height, frame.width), np.float32)
    for rows in imageops.row_bands(frame.width, frame.height):
        rays = types.panorama_rays(frame.width, frame.height, rows)
        total, weight = np.zeros(rays.shape[:2], np.float32), np.zeros(rays.shape[:2], np.float32)
        for offset, (log, share) in zip(offsets, _samples(rays, turns, logs), strict=True):
            total += (log + np.float32(offset)) * share
            weight += share
        with np.errstate(invalid="ignore"):
            distance[rows] = np.exp(total / weight)
    return distance


def _rotation(yaw_deg: float, pitch_deg: float) -> types.Float64Array:
    """From directions of a view to those of the panorama; x right, y down, z ahead."""
    up, _ = cv2.Rodrigues(np.radians([pitch_deg, 0, 0]))
    right, _ = cv2.Rodrigues(np.radians([0, yaw_deg, 0]))
    return np.asarray(right @ up, np.float64)


def _view_rays(side: int) -> types.Float32Array:
    """Directions of the pixels of a view, (side, side, 3), with z = 1."""
    along = ((np.arange(side) + 0.5) * 2 / side - 1) * _HALF_VIEW
    x, y = np.meshgrid(along, along)
    return np.stack([x, y, np.ones_like(x)], -1).astype(np.float32)


def _view(panorama: types.AnyArray, turn: types.Float64Array, side: int) -> types.AnyArray:
    height, width = panorama.shape[:2]
    x, y, z = np.moveaxis(_view_rays(side) @ turn.T.astype(np.float32), -1, 0)
    column = (np.arctan2(x, z) / (2 * math.pi) + 0.5) * width - 0.5
    row = (np.arctan2(y, np.hypot(x, z)) / math.pi + 0.5) * height - 0.5
    wrapped = cv2.copyMakeBorder(panorama, 0, 0, 1, 1, cv2.BORDER_WRAP)
    maps = (column + 1).astype(np.float32), row.astype(np.float32)
    return np.asarray(cv2.remap(wrapped, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def _samples(
    rays: types.Float32Array, turns: list[types.Float64Array], logs: list[types.Float32Array]
) -> Iterator[tuple[types.Float32Array, types.Float32Array]]:
    """Log distance of each view along some rays, (h, w), and its weight, 0 outside a circle."""
    for turn, log in zip(turns, logs, strict=True):
        x, y, z = np.moveaxis(rays @ turn.astype(np.float32), -1, 0)
        ahead = np.where(z > 0, z, np.float32(np.inf)) * np.float32(_HALF_VIEW)
        across, down = x / ahead, y / ahead
        weight = np.where(z > 0, 1 - across**2 - down**2, 0).clip(0) ** 2
        half = log.shape[0] / 2
        maps = (across + 1) * half - 0.5, (down + 1) * half - 0.5
        samples = cv2.remap(log, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        yield np.asarray(samples), weight.astype(np.float32)


def _offsets(
    samples: list[tuple[types.Float32Array, types.Float32Array]], is_level: types.BoolArray
) -> types.Float64Array:
    """Addend of each view's log distance: least squares of the differences in overlaps."""
    count = len(samples)
    matrix = np.diag(np.where(is_level, _LEVEL_WEIGHT, 0.0) + _LEVEL_WEIGHT * 1e-3)
    target = np.zeros(count)
    for i, (log, weight) in enumerate(samples):
        for j, (other, other_weight) in enumerate(samples[:i]):
            both = weight * other_weight
            share = float(both.mean(dtype=np.float64))
            difference = float((both * (other - log)).mean(dtype=np.float64))
            matrix[[i, j], [i, j]] += share
            matrix[[i, j], [j, i]] -= share
            target[i] += difference
            target[j] -= difference
    return np.asarray(np.linalg.solve(matrix, target), np.float64)
