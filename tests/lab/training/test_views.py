"""Views against the pinhole camera, ray by ray, in plain loops, at any field of view."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.rooms import Rooms, batches_of
from helpers.seeded import seeded
from torch import Tensor

from depthcli.lab.training.augment import augment, draw_views, view_size
from depthcli.lab.training.config import DataConfig
from depthcli.lab.training.data import PairStore

DATA = DataConfig(width=64, height=48, zoom=1.6, turn=1.0)
HALF_X = math.tan(math.radians(63.3 / 2))
HALF_Y = HALF_X * 48 / 64
NYU = (HALF_X, HALF_Y)


@pytest.mark.parametrize("rotate_deg", [0, 8])
@pytest.mark.parametrize("halves", [NYU, (1.0, 0.75), (0.7, 0.7), (0.8, 0.45), (0.4, 0.7)])
@pytest.mark.parametrize("size", [(64, 48), (48, 64)])
def test_a_turned_view_is_what_a_turned_camera_sees(
    size: tuple[int, int], halves: tuple[float, float], rotate_deg: float
) -> None:
    """Angles between rays are kept, and depth is the distance along the turned axis.

    ``halves`` is half the width and height of the image at depth 1.
    """
    fov = None if halves == NYU else torch.tensor([halves], dtype=torch.float64).expand(12, 2)
    data = replace(DATA, rotate_deg=rotate_deg)
    turned = draw_views(12, size, data, seeded(1), fov)
    plain = draw_views(12, size, replace(data, turn=0.0), seeded(1), fov)
    # Of the image, and of the view, whose focal length is the network's times the zoom.
    true = turned.grid * torch.tensor(halves)
    view = _places(size) * torch.tensor(halves) * torch.tensor([size[0] / 64, size[1] / 48])
    lengths, directions = [], []
    for places in (true, view * plain.depth_scale):
        corners = places[:, [0, 0, -1, size[1] // 2], [0, -1, 0, size[0] // 3]]
        rays = torch.cat([corners, torch.ones(12, 4, 1)], 2)
        lengths.append(rays.norm(dim=2))
        directions.append(rays / lengths[-1][..., None])
    cosines = [unit @ unit.transpose(1, 2) for unit in directions]
    torch.testing.assert_close(*cosines, atol=2e-5, rtol=0)
    scale = (turned.depth_scale / plain.depth_scale).expand(-1, 1, *turned.grid.shape[1:3])
    scale = scale[:, 0, [0, 0, -1, size[1] // 2], [0, -1, 0, size[0] // 3]]
    torch.testing.assert_close(lengths[0], scale * lengths[1], rtol=1e-4, atol=0)


def _places(size: tuple[int, int]) -> Tensor:
    """(x, y) of each pixel of a view, (H, W, 2) in [-1, 1] from edge to edge."""
    x, y = ((torch.arange(side) * 2 + 1) / side - 1 for side in size)
    return torch.stack(torch.meshgrid(x, y, indexing="xy"), -1)


@pytest.mark.parametrize("aspect", [1 / 2, 9 / 16, 3 / 4, 1, 4 / 3, 16 / 9, 21 / 9])
@pytest.mark.parametrize("halves", [NYU, (0.7, 0.7), (0.4, 0.7)])
def test_rotated_views_of_any_aspect_stay_inside_and_use_their_margin(
    aspect: float, halves: tuple[float, float]
) -> None:
    fov = torch.tensor([halves], dtype=torch.float64).expand(2000, 2)
    data = replace(DATA, rotate_deg=11.4, turn=0.0, aspects=(aspect,))
    grid = draw_views(2000, data.view_sides(aspect), data, seeded(2), fov).grid
    assert grid.abs().max() <= 1 + 1e-5
    assert grid.abs().amax((0, 1, 2)).min() > 0.97  # of pixel centres
    across = grid[:, :, -1] - grid[:, :, 0]  # a rotated row also leads up or down
    rise = torch.atan2(across[..., 1] * halves[1], across[..., 0].abs() * halves[0])
    largest_deg = math.degrees(float(rise.abs().max()))
    square = max(halves[0] / halves[1], halves[1] / halves[0])
    assert largest_deg == pytest.approx(min(11.4, math.degrees(0.2 / square)), rel=0.05)


def test_without_turning_a_view_is_a_plain_cut() -> None:
    plain = draw_views(8, (64, 48), replace(DATA, turn=0.0), seeded(2))
    assert plain.inside is None
    assert plain.depth_scale.shape == (8, 1, 1, 1)
    steps = plain.grid[:, :, 1:, 0] - plain.grid[:, :, :-1, 0]
    assert float((steps.amax((1, 2)) - steps.amin((1, 2))).abs().max()) < 1e-5


def test_views_of_other_shapes_fit_and_keep_the_focal_length() -> None:
    """A portrait view of a landscape image is zoomed in until it fits, and metres follow."""
    geometry = draw_views(40, (48, 64), replace(DATA, turn=0.0), seeded(3))
    assert float(geometry.grid.abs().max()) <= 1
    step_y = (geometry.grid[:, 1, 0, 1] - geometry.grid[:, 0, 0, 1]) * HALF_Y
    focal = 1 / step_y / (48 / (2 * HALF_Y))  # in units of the network's
    torch.testing.assert_close(1 / geometry.depth_scale.flatten(), focal, rtol=1e-4, atol=0)
    assert float(focal.min()) == pytest.approx(64 / 48, rel=1e-4)


def test_pixels_outside_of_the_image_are_invalid() -> None:
    geometry = draw_views(60, (64, 48), DATA, seeded(4))
    assert geometry.inside is not None
    outside = (geometry.grid.abs() > 1).any(-1)[:, None]
    assert torch.equal(geometry.inside, ~outside)
    assert 0 < int(outside.sum()) < 0.05 * outside.numel()
    rgb, depth_m = torch.rand(60, 3, 96, 128), torch.full((60, 1, 96, 128), 2.0)
    valid_mask = augment(rgb, depth_m, DATA, seeded(4)).valid_mask
    assert not valid_mask.all()


def test_sizes_of_views_keep_the_number_of_pixels() -> None:
    data = DataConfig(width=192, height=144, aspects=(16 / 9, 1.0, 0.75))
    random = seeded(5)
    sizes = [view_size(data, random) for _ in range(300)]
    assert set(sizes) == {(192, 144), (224, 128), (160, 160), (144, 192)}
    assert 110 < sizes.count((192, 144)) < 190
    assert view_size(DATA, random) == (64, 48)


def _border_levels(**changes: float) -> Tensor:
    """Levels of the outermost pixels of gray images with a white border."""
    rgb = torch.full((200, 3, 96, 128), 0.5)
    rgb[..., 0], rgb[..., -1], rgb[..., 0, :], rgb[..., -1, :] = 1, 1, 1, 1
    data = replace(DATA, zoom=1.0, turn=0.0, **changes)
    gray = augment(rgb, torch.ones(200, 1, 96, 128), data, seeded(6)).network_input
    assert torch.all(gray[..., 4:-4, 4:-4] == 0)
    return (gray[:, 0, 20, 0] + 1) / 2


def test_borders_are_kept_replaced_or_painted() -> None:
    assert torch.all(_border_levels() > 0.7)
    levels = _border_levels(border=1.0)
    replaced = (levels - 0.5).abs() < 1e-6
    assert 70 < int(replaced.sum()) < 130
    painted = levels[~replaced]
    assert float(painted.min()) < 0.2
    assert len(painted.unique()) > 40
    assert int((_border_levels(border=0.5) > 0.74).sum()) > 70


@pytest.mark.parametrize("border", [0.0, 1e-6])
def test_beyond_its_edge_an_image_goes_on_as_it_ends(border: float) -> None:
    """A gray room stays gray, and its flat wall flat, wherever a camera is turned."""
    data = replace(DATA, border=border)
    wall_m = torch.full((60, 1, 96, 128), 2.0)
    views = augment(torch.full((60, 3, 96, 128), 0.25), wall_m, data, seeded(4))
    assert not views.valid_mask.all()
    torch.testing.assert_close(views.network_input, torch.full_like(views.network_input, -0.5))
    scale = draw_views(60, (64, 48), DATA, seeded(4)).depth_scale
    torch.testing.assert_close(views.depth_m, 2 * scale)


COUNT = 8
NYU_HALF_WIDTH = math.tan(math.radians(63.3 / 2))
WIDE_DATA = DataConfig(width=64, height=48, zoom=1.6, turn=1.0, rotate_deg=8)
SHAPES = replace(WIDE_DATA, aspects=(1.7778, 1.0, 0.75, 0.5625))


def _black(*shape: int) -> Rooms:
    """Images (height, width), and a depth of 1 m."""
    size = (COUNT, *shape)
    return Rooms(np.zeros((*size, 3), np.uint8), np.ones(size, np.float32), ("",) * COUNT)


def _ramps(like: Tensor) -> list[Tensor]:
    """Depth (N, 1, h, w) of 1 m, of 2 m + x, and of 2 m + y; (x, y) in [-1, 1] as of grids."""
    across, down = (2 + _places(like.shape[:1:-1])).unbind(-1)
    return [torch.ones(like.shape), across.expand(like.shape), down.expand(like.shape)]


def _variation(data: DataConfig, dataset: Rooms, halves: Tensor) -> float:
    """Largest variation in a view of (label ÷ depth along its axis), which is 1 ÷ zoom everywhere.

    ``halves`` (COUNT, 2) is half the width and height of the images at depth 1.
    """
    store = PairStore(dataset, range(COUNT), data)
    batches = batches_of(store, data, COUNT)
    ramps, largest = _ramps(store.depth_m), 0.0
    for step in range(12):
        depths_m = []
        for store.depth_m in ramps:
            depths_m.append(batches[step].depth_m[:, 0])
        flat, *places = depths_m
        assert float(flat.min()) > 0
        grid = torch.stack([place / flat - 2 for place in places], -1)
        rows = batches._rows(store, step, COUNT, stream=2 if data.paired else 3)
        rays = torch.cat([grid * halves[rows, None, None], torch.ones_like(flat)[..., None]], -1)
        y, x = (side // 2 for side in flat.shape[1:])
        middle = rays[:, y - 1 : y + 1, x - 1 : x + 1]
        axis = (middle / middle.norm(dim=-1, keepdim=True)).sum((1, 2))
        ratio = flat / torch.einsum("bhwc,bc->bhw", rays, axis)
        inner = (grid.abs() < 0.95).all(-1)  # the ramps end with the outermost pixels
        for view, inside in zip(ratio, inner, strict=True):
            largest = max(largest, float(view[inside].max() / view[inside].min()) - 1)
    return largest


@pytest.mark.parametrize(
    "data", [WIDE_DATA, SHAPES, replace(WIDE_DATA, width=48), replace(WIDE_DATA, height=96)]
)
@pytest.mark.parametrize("shape", [(48, 64), (54, 96), (96, 54), (64, 64)])
@pytest.mark.parametrize("hfov_deg", [None, 90])
def test_labels_of_a_turned_view_are_depth_along_its_axis(
    data: DataConfig, shape: tuple[int, int], hfov_deg: float | None
) -> None:
    """Whatever the image's shape, that of the network's input, and the camera."""
    dataset, (height, width) = _black(*shape), shape
    if hfov_deg is None:  # the largest crop of NYU's image
        half_width = NYU_HALF_WIDTH * width / max(width, height, min(width, height) * 4 / 3)
    else:
        dataset = replace(dataset, hfov_deg=hfov_deg)
        half_width = math.tan(math.radians(hfov_deg / 2))
    halves = torch.tensor([half_width, half_width * height / width]).expand(COUNT, 2)
    assert _variation(data, dataset, halves) < 0.001


def test_each_image_is_turned_with_its_own_focal_length() -> None:
    focal_px = torch.linspace(25, 90, COUNT)
    dataset = replace(_black(48, 64), focal_px=tuple(focal_px.tolist()))
    assert _variation(WIDE_DATA, dataset, torch.tensor([32, 24]) / focal_px[:, None]) < 0.001


def test_unpaired_depth_is_turned_with_its_own_shape() -> None:
    dataset = replace(_black(48, 64), depths_m=_black(96, 54).depths_m)
    halves = torch.tensor([NYU_HALF_WIDTH * 54 / 96, NYU_HALF_WIDTH]).expand(COUNT, 2)
    assert _variation(replace(WIDE_DATA, paired=False), dataset, halves) < 0.001


def test_wide_camera_gives_no_negative_depth() -> None:
    dataset, half_width = replace(_black(48, 64), hfov_deg=160), math.tan(math.radians(80))
    halves = torch.tensor([half_width, half_width * 0.75]).expand(COUNT, 2)
    assert _variation(WIDE_DATA, dataset, halves) < 0.001
