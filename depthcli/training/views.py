"""Random views of a picture, and the depth that follows from them, by the pinhole camera model.

All views have the same focal length, in pixels of the network's input. So zooming in by s divides
depth by s, a view with another aspect ratio shows less of the picture, and an off-centre view is
either a crop or the view of a rotated camera.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from depthcli.datasets.training_data import NYU_HFOV_DEG
from depthcli.training.config.schema import DataConfig

_WHOLE_SHARE = 0.25  # fraction of views without zoom, like pictures at inference
_FULL_ROTATION_ZOOM = 0.2  # a zoom of 1.2 leaves room for the largest rotation
_CROP_286 = 286 / 256
_HALF_WIDTH = math.tan(math.radians(NYU_HFOV_DEG / 2))  # half of the picture's width at depth 1
_LEAST_Z = 0.1  # a ray with less leaves a picture of up to 168°; behind it, depth is negative


class Geometry(NamedTuple):
    """Sampling grid and depth scale of some views."""

    grid: Tensor  #: (B, H, W, 2) float32, (x, y) in the pictures, [-1, 1] from edge to edge
    #: (B, 1, 1, 1) or (B, 1, H, W) float32, depth in the view per depth in the picture
    depth_scale: Tensor
    #: (B, 1, H, W) bool, False where the view leaves the picture; None if it never does
    inside: Tensor | None


def view_size(data: DataConfig, random: torch.Generator) -> tuple[int, int]:
    """Width and height of a batch's views, px; the number of pixels is about the same for all."""
    if not data.aspects or float(torch.rand((), generator=random)) < 0.5:  # noqa: PLR2004 - half
        return data.width, data.height
    index = int(torch.randint(len(data.aspects), (), generator=random))
    return data.view_sides(data.aspects[index])


def draw_views(
    count: int,
    size: tuple[int, int],
    data: DataConfig,
    random: torch.Generator,
    tan_half_fov: Tensor | None = None,
) -> Geometry:
    """Sample views of ``size`` (width, height) px from pictures stretched to the network's input.

    ``tan_half_fov`` (``count``, 2) float64 is the tangent of half the angle of view of each
    picture, across and down; None is NYU's angle across, and square pixels of the input.
    """
    if tan_half_fov is None:
        down = _HALF_WIDTH * data.height / data.width
        tan_half_fov = torch.tensor([[_HALF_WIDTH, down]], dtype=torch.float64)
    aspect = (tan_half_fov[:, 0] / tan_half_fov[:, 1]).float()
    cover = torch.tensor([size[0] / data.width, size[1] / data.height])
    least = max(1.0, float(cover.max()))  # zoom at which the view fits into the picture
    zoom = _zooms(count, data, random) * least
    view = _affine(zoom, cover, aspect, data, random)
    grid = _sampling_grid(view, *size)
    metric_zoom = zoom / _CROP_286 if data.crop_286 else zoom
    depth_scale = 1 / metric_zoom.view(-1, 1, 1, 1)
    if not data.turn:
        return Geometry(grid, depth_scale, None)
    turned = torch.rand(count, generator=random) < data.turn
    grid, along_axis = _rotate_camera(grid, view[:, :, 2] * turned[:, None], tan_half_fov.float())
    inside = (grid.abs() <= 1).all(-1)[:, None]
    return Geometry(grid, depth_scale / along_axis[:, None], inside)


def _zooms(count: int, data: DataConfig, random: torch.Generator) -> Tensor:
    if data.crop_286:
        return torch.full((count,), _CROP_286)
    zoom = torch.exp(torch.rand(count, generator=random) * math.log(data.zoom))
    whole = torch.rand(count, generator=random) < _WHOLE_SHARE
    return torch.where(whole, torch.ones(()), zoom)


def _affine(
    zoom: Tensor, cover: Tensor, aspect: Tensor, data: DataConfig, random: torch.Generator
) -> Tensor:
    """Affine maps (B, 2, 3) from view to picture coordinates; views lie inside the picture."""
    uniform = torch.rand(4, len(zoom), generator=random) * 2 - 1
    mirror = torch.where(uniform[0] < 0, -1.0, 1.0)
    spare = zoom / cover.max().clamp(min=1) - 1
    room = spare.clamp(max=_FULL_ROTATION_ZOOM) / _FULL_ROTATION_ZOOM
    largest = _FULL_ROTATION_ZOOM / torch.maximum(aspect, 1 / aspect)
    angle = uniform[1] * largest.clamp(max=math.radians(data.rotate_deg)) * room
    cos, sin = torch.cos(angle) / zoom, torch.sin(angle) / zoom
    across, down = cover
    shift_x = uniform[2] * (1 - cos * across - sin.abs() * down / aspect).clamp(min=0)
    shift_y = uniform[3] * (1 - cos * down - sin.abs() * across * aspect).clamp(min=0)
    row_x = torch.stack([cos * across * mirror, -sin * down / aspect, shift_x], 1)
    row_y = torch.stack([sin * across * aspect * mirror, cos * down, shift_y], 1)
    return torch.stack([row_x, row_y], 1)


def _sampling_grid(view: Tensor, width: int, height: int) -> Tensor:
    """Picture coordinates of each pixel of the views, (B, H, W, 2) in [-1, 1]."""
    # F.affine_grid gives the same, but its batched matrix product takes 1.4 ms of a 190 ms step.
    x = (torch.arange(width) * 2 + 1) / width - 1
    y = (torch.arange(height) * 2 + 1) / height - 1
    along_x, along_y, shift = view[:, None, None].unbind(-1)
    return along_x * x[:, None] + (along_y * y[:, None, None] + shift)


def _rotate_camera(grid: Tensor, shift: Tensor, halves: Tensor) -> tuple[Tensor, Tensor]:
    """Replace a shift (B, 2) by a camera rotation; the new grid, and z of each ray (B, H, W).

    The rotation is the smallest that takes the optical axis to the centre of the view. ``halves``
    (B, 2) is half the width and height of the pictures at depth 1.
    """
    axis = torch.cat([shift * halves, torch.ones(len(shift), 1)], 1)
    halves = halves[:, None, None]
    x, y = ((grid - shift[:, None, None]) * halves).unbind(-1)
    a, b, c = (axis / axis.norm(dim=1, keepdim=True))[:, :, None, None].unbind(1)
    # Rodrigues' formula for the rotation of (0, 0, 1) to (a, b, c).
    towards = (a * x + b * y) / (1 + c)
    z = (c - a * x - b * y).clamp(min=_LEAST_Z)
    new_x, new_y = x - a * towards + a, y - b * towards + b
    return torch.stack([new_x / z, new_y / z], -1) / halves, z
