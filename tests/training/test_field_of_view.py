"""Turned views of pictures of any shape and camera, from the data set to the batch."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from helpers.rooms import Rooms
from torch import Tensor

from depthcli.training.config import DataConfig
from depthcli.training.data import Batches, PairStore

COUNT = 8
NYU = math.tan(math.radians(63.3 / 2))
DATA = DataConfig(width=64, height=48, zoom=1.6, turn=1.0, rotate_deg=8)
SHAPES = replace(DATA, aspects=(1.7778, 1.0, 0.75, 0.5625))


@dataclass(frozen=True)
class OneCamera(Rooms):
    """Pictures of one known camera."""

    hfov_deg: float = 0


@dataclass(frozen=True)
class ManyCameras(Rooms):
    """Pictures of a known focal length each."""

    focal_px: tuple[float, ...] = ()


def _black(*shape: int) -> Rooms:
    """Pictures (height, width), and a depth of 1 m."""
    size = (COUNT, *shape)
    return Rooms(np.zeros((*size, 3), np.uint8), np.ones(size, np.float32), ("",) * COUNT)


def _ramps(like: Tensor) -> list[Tensor]:
    """Depth (N, 1, h, w) of 1 m, of 2 m + x, and of 2 m + y; (x, y) in [-1, 1] as of grids."""
    height, width = like.shape[2:]
    across = 2 + (torch.arange(width) * 2 + 1) / width - 1
    down = 2 + (torch.arange(height)[:, None] * 2 + 1) / height - 1
    return [torch.ones(like.shape), across.expand(like.shape), down.expand(like.shape)]


def _variation(data: DataConfig, dataset: Rooms, halves: Tensor) -> float:
    """Largest variation in a view of (label ÷ depth along its axis), which is 1 ÷ zoom everywhere.

    ``halves`` (COUNT, 2) is half the width and height of the pictures at depth 1.
    """
    store = PairStore(dataset, range(COUNT), data)
    batches = Batches(store, data, COUNT, 0, torch.device("cpu"))
    ramps, largest = _ramps(store.depth_m), 0.0
    for step in range(12):
        seen = []
        for store.depth_m in ramps:
            seen.append(batches[step].depth_m[:, 0])
        flat, *places = seen
        assert float(flat.min()) > 0
        grid = torch.stack([place / flat - 2 for place in places], -1)
        rows = batches._rows(store, step, COUNT, stream=2 if data.paired else 3)
        rays = torch.cat([grid * halves[rows, None, None], torch.ones_like(flat)[..., None]], -1)
        y, x = (side // 2 for side in flat.shape[1:])
        middle = rays[:, y - 1 : y + 1, x - 1 : x + 1]
        axis = (middle / middle.norm(dim=-1, keepdim=True)).sum((1, 2))
        ratio = flat / torch.einsum("bhwc,bc->bhw", rays, axis)
        inner = (grid.abs() < 0.95).all(-1)  # the ramps end with the outermost pixels
        for view, kept in zip(ratio, inner, strict=True):
            largest = max(largest, float(view[kept].max() / view[kept].min()) - 1)
    return largest


@pytest.mark.parametrize("data", [DATA, SHAPES, replace(DATA, width=48), replace(DATA, height=96)])
@pytest.mark.parametrize("shape", [(48, 64), (54, 96), (96, 54), (64, 64)])
@pytest.mark.parametrize("hfov_deg", [None, 90])
def test_labels_of_a_turned_view_are_depth_along_its_axis(
    data: DataConfig, shape: tuple[int, int], hfov_deg: float | None
) -> None:
    """Whatever the picture's shape, that of the network's input, and the camera."""
    dataset, (height, width) = _black(*shape), shape
    if hfov_deg is None:  # the largest crop of NYU's picture
        half_width = NYU * width / max(width, height, min(width, height) * 4 / 3)
    else:
        dataset = OneCamera(dataset.images, dataset.depths_m, dataset.scenes, hfov_deg)
        half_width = math.tan(math.radians(hfov_deg / 2))
    halves = torch.tensor([half_width, half_width * height / width]).expand(COUNT, 2)
    assert _variation(data, dataset, halves) < 0.001


def test_each_picture_is_turned_with_its_own_focal_length() -> None:
    black, focal_px = _black(48, 64), torch.linspace(25, 90, COUNT)
    dataset = ManyCameras(black.images, black.depths_m, black.scenes, tuple(focal_px.tolist()))
    assert _variation(DATA, dataset, torch.tensor([32, 24]) / focal_px[:, None]) < 0.001


def test_unpaired_depth_is_turned_with_its_own_shape() -> None:
    dataset = replace(_black(48, 64), depths_m=_black(96, 54).depths_m)
    halves = torch.tensor([NYU * 54 / 96, NYU]).expand(COUNT, 2)
    assert _variation(replace(DATA, paired=False), dataset, halves) < 0.001


def test_wide_camera_gives_no_negative_depth() -> None:
    black, half_width = _black(48, 64), math.tan(math.radians(80))
    dataset = OneCamera(black.images, black.depths_m, black.scenes, 160)
    halves = torch.tensor([half_width, half_width * 0.75]).expand(COUNT, 2)
    assert _variation(DATA, dataset, halves) < 0.001
