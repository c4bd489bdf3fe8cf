"""Depth of an equirectangular panorama, from overlapping pinhole views that are joined.

Each view is multiplied by one factor, so that they agree best where they overlap, as in MoGe (Wang
et al., arXiv:2410.19115), and they are blended in log distance with weights that are 0 at their
borders, so that there is no seam. Metres are those of the level views, which are what a network
learned; its own field of view suits it best, so there are 26 views in place of MoGe's twelve.
"""

import math
from collections.abc import Callable, Iterator

import cv2
import numpy as np

from depthcli.core.arrays import AnyArray, BoolArray, Float32Array, Float64Array
from depthcli.core.imageops import resize_area, row_bands
from depthcli.core.types import Frame, panorama_rays
from depthcli.errors import InputError

HFOV_DEG = 65.0  #: field of view of a view, which is square
_MAX_VIEW_PX = 1024
_VIEWS_DEG = (
    *((yaw, 0.0) for yaw in range(0, 360, 45)),
    *((yaw + 22.5, pitch) for pitch in (45.0, -45.0) for yaw in range(0, 360, 45)),
    *((0.0, pitch) for pitch in (90.0, -90.0)),
)
"""(yaw to the right, pitch up) of each view; the first row of the image is at a pitch of 90°."""
_PRIOR_WEIGHT = 1e-6  # of factors of one of level views, as images of the training are
_GRID_PX = 256, 128  # pixels of the panorama at which factors are fitted


def panorama_distance(frame: Frame, predict: Callable[[Frame], Float32Array]) -> Float32Array:
    """Distance along the ray of each pixel of an equirectangular image, (H, W) float32 metres.

    ``predict`` gives metres along the axis, (h, w) float32, of a view of :data:`HFOV_DEG`.
    """
    if abs(frame.width - 2 * frame.height) > 2:  # noqa: PLR2004
        size = f"{frame.width}×{frame.height}"
        problem = f"a panorama of all directions is twice as wide as high, not {size}"
        raise InputError(problem, "give {projection} pinhole, or the whole panorama")
    half = math.tan(math.radians(HFOV_DEG) / 2)
    side = min(_MAX_VIEW_PX, max(8, round(frame.width / math.pi * half)))
    width = min(frame.width, round(side * math.pi / half))
    small = resize_area(frame.pixels, width, max(1, width // 2))  # type: ignore[arg-type]
    turns, logs, are_level = list[Float64Array](), list[Float32Array](), list[bool]()
    for yaw_deg, pitch_deg in _VIEWS_DEG:
        turn = _rotation(yaw_deg, pitch_deg)
        view = np.ascontiguousarray(_view(small, turn, side))
        log = np.log(predict(Frame(view)) * np.linalg.norm(_view_rays(side), axis=-1))
        if np.isfinite(log).all():
            turns.append(turn)
            logs.append(log)
            are_level.append(pitch_deg == 0)
    if not logs:
        raise InputError("no view of the panorama has depth everywhere")
    samples = [*_samples(panorama_rays(*_GRID_PX), turns, logs)]
    offsets = _offsets(samples, np.array(are_level))
    distance = np.empty((frame.height, frame.width), np.float32)
    for rows in row_bands(frame.width, frame.height):
        rays = panorama_rays(frame.width, frame.height, rows)
        total, weight = np.zeros(rays.shape[:2], np.float32), np.zeros(rays.shape[:2], np.float32)
        for offset, (log, share) in zip(offsets, _samples(rays, turns, logs), strict=True):
            total += (log + np.float32(offset)) * share
            weight += share
        with np.errstate(invalid="ignore", divide="ignore"):
            distance[rows] = np.exp(total / weight)
    return distance


def _rotation(yaw_deg: float, pitch_deg: float) -> Float64Array:
    """From directions of a view to those of the panorama; x right, y down, z ahead."""
    up, _ = cv2.Rodrigues(np.radians([pitch_deg, 0, 0]))
    right, _ = cv2.Rodrigues(np.radians([0, yaw_deg, 0]))
    return np.asarray(right @ up, np.float64)


def _view_rays(side: int) -> Float32Array:
    """Directions of the pixels of a view, (side, side, 3), with z = 1."""
    along = ((np.arange(side) + 0.5) * 2 / side - 1) * math.tan(math.radians(HFOV_DEG) / 2)
    x, y = np.meshgrid(along, along)
    return np.stack([x, y, np.ones_like(x)], -1).astype(np.float32)


def _view(panorama: AnyArray, turn: Float64Array, side: int) -> AnyArray:
    height, width = panorama.shape[:2]
    x, y, z = np.moveaxis(_view_rays(side) @ turn.T.astype(np.float32), -1, 0)
    column = (np.arctan2(x, z) / (2 * math.pi) + 0.5) * width - 0.5
    row = (np.arctan2(y, np.hypot(x, z)) / math.pi + 0.5) * height - 0.5
    wrapped = cv2.copyMakeBorder(panorama, 0, 0, 1, 1, cv2.BORDER_WRAP)
    maps = (column + 1).astype(np.float32), row.astype(np.float32)
    view = cv2.remap(wrapped, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(view)


def _samples(
    rays: Float32Array, turns: list[Float64Array], logs: list[Float32Array]
) -> Iterator[tuple[Float32Array, Float32Array]]:
    """Log distance of each view along some rays, (h, w), and its weight, 0 outside a circle."""
    for turn, log in zip(turns, logs, strict=True):
        x, y, z = np.moveaxis(rays @ turn.astype(np.float32), -1, 0)
        ahead = np.where(z > 0, z, np.float32(np.inf)) * np.float32(
            math.tan(math.radians(HFOV_DEG) / 2)
        )
        across, down = x / ahead, y / ahead
        weight = np.where(z > 0, 1 - across**2 - down**2, 0).clip(0) ** 2
        half = log.shape[0] / 2
        maps = (across + 1) * half - 0.5, (down + 1) * half - 0.5
        samples = cv2.remap(log, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        yield np.asarray(samples), weight.astype(np.float32)


def _offsets(samples: list[tuple[Float32Array, Float32Array]], is_level: BoolArray) -> Float64Array:
    """Addend of each view's log distance: least squares of the differences in overlaps."""
    count = len(samples)
    matrix = np.diag(np.where(is_level, _PRIOR_WEIGHT, 0.0) + _PRIOR_WEIGHT * 1e-3)
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
