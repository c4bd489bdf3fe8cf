"""Augmentation that keeps depth metric; the geometry is that of :mod:`~depthcli.training.views`."""

from typing import NamedTuple

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

from depthcli.training.config.schema import DataConfig
from depthcli.training.data.cutmix import cutmix
from depthcli.training.views import draw_views, view_size

_ALL_VALID = 0.999  # least interpolated mask of a valid pixel
_MAX_BORDER = 0.03  # as a fraction of half the picture; NYU Depth v2's is .029


class Views(NamedTuple):
    """Augmented views of some pairs."""

    network_input: Tensor  #: (B, 1, H, W) float32 in [-1, 1]
    depth_m: Tensor  #: (B, 1, H, W) float32 metres, with the same geometry
    #: (B, 1, H, W) bool, False where depth was not measured; None if all of it was
    valid_mask: Tensor | None


def augment(
    rgb: Tensor,
    depth_m: Tensor,
    data: DataConfig,
    random: torch.Generator,
    valid_mask: Tensor | None = None,
    size: tuple[int, int] | None = None,
    tan_half_fov: Tensor | None = None,
) -> Views:
    """Random views of pairs.

    Args:
        rgb: (B, 3, h, w) float32 in [0, 1].
        depth_m: (B, 1, h, w) float32 metres, aligned with ``rgb``.
        data: sizes and strengths.
        random: the only source of randomness.
        valid_mask: (B, 1, h, w) bool, where depth was measured; None if it was everywhere.
        size: width and height of the views, px; sampled if it is None.
        tan_half_fov: (B, 2) float64, as :func:`~depthcli.training.views.draw_views` takes it.
    """
    size = view_size(data, random) if size is None else size
    geometry = draw_views(len(rgb), size, data, random, tan_half_fov)
    grid = geometry.grid.to(rgb.device)
    gray = _gray(_jitter_colour(rgb, data, random), data)  # before resampling, as at inference
    gray = _sample_with_borders(gray, grid, data, random)
    depth_m = F.grid_sample(depth_m, grid, padding_mode="border", align_corners=False)
    depth_m = depth_m * geometry.depth_scale.to(depth_m.device)
    if valid_mask is not None:
        share = F.grid_sample(valid_mask.float(), grid, padding_mode="border", align_corners=False)
        valid_mask = share > _ALL_VALID
    if geometry.inside is not None:
        inside = geometry.inside.to(rgb.device)
        valid_mask = inside if valid_mask is None else valid_mask & inside
    views = Views(_jitter_exposure(gray, data, random), depth_m, valid_mask)
    return _cutmix_views(views, data.cutmix, random) if data.cutmix else views


def to_network_input(rgb: Tensor, data: DataConfig) -> Tensor:
    """The gray network input (B, 1, H, W) in [-1, 1] of RGB (B, 3, H, W) in [0, 1]."""
    return _gray(rgb, data) * 2 - 1


def _gray(rgb: Tensor, data: DataConfig) -> Tensor:
    if data.colour == "value":
        return rgb.amax(1, keepdim=True)
    weights = torch.tensor([0.299, 0.587, 0.114], device=rgb.device).view(1, 3, 1, 1)
    return (rgb * weights).sum(1, keepdim=True)


def _cutmix_views(views: Views, share: float, random: torch.Generator) -> Views:
    maps = [
        views.network_input,
        views.depth_m,
        *([] if views.valid_mask is None else [views.valid_mask]),
    ]
    gray, depth_m, *valid_mask = cutmix(maps, share, random)
    return Views(gray, depth_m, valid_mask[0] if valid_mask else None)


def _sample_with_borders(
    gray: Tensor, grid: Tensor, data: DataConfig, random: torch.Generator
) -> Tensor:
    """Sample V; in some views the border is painted over or replaced by its inner edge."""
    if not data.border:
        return F.grid_sample(gray, grid, padding_mode="border", align_corners=False)
    drawn = torch.rand(3, len(gray), 1, 1, 1, generator=random).to(gray.device)
    chosen, width, level = drawn[0], drawn[1] * _MAX_BORDER, drawn[2]
    replaced, painted = chosen < data.border / 2, chosen > 1 - data.border / 2
    limit = torch.where(replaced, 1 - _MAX_BORDER, 1.0)
    seen = F.grid_sample(
        gray, grid.clamp(-limit, limit), padding_mode="border", align_corners=False
    )
    outer = (grid.abs() > 1 - width).any(-1)[:, None]
    return torch.where(outer & painted, level, seen)


def _jitter_colour(rgb: Tensor, data: DataConfig, random: torch.Generator) -> Tensor:
    """Scale each colour channel by a random gain."""
    if not data.colour_jitter:
        return rgb
    gain = torch.exp(torch.randn((len(rgb), 3, 1, 1), generator=random) * data.colour_jitter)
    return rgb * gain.to(rgb.device)


def _jitter_exposure(gray: Tensor, data: DataConfig, random: torch.Generator) -> Tensor:
    """Random gamma, brightness, blur and noise; (B, 1, H, W) in [0, 1] to [-1, 1]."""

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, generator=random).to(gray.device)

    count = len(gray)
    if data.gamma:
        gray = gray.clamp(min=1e-4).pow_(torch.exp(normal(count, 1, 1, 1) * data.gamma))
    if data.brightness:
        gain = torch.exp(normal(count, 1, 1, 1) * data.brightness)
        gray = gray * gain + normal(count, 1, 1, 1) * (data.brightness / 4)
    if data.blur:
        blend = torch.rand(count, 1, 1, 1, generator=random).to(gray.device) * data.blur
        gray = torch.lerp(gray, _binomial_blur(gray), blend)
    if data.noise:
        strength = torch.rand(count, 1, 1, 1, generator=random).to(gray.device) * data.noise
        gray = normal(*gray.shape).mul_(strength).add_(gray)
    return gray.clamp(0, 1).mul_(2).sub_(1)


def _binomial_blur(gray: Tensor) -> Tensor:
    """The binomial filter [1, 4, 6, 4, 1] / 16 along both axes."""
    kernel = torch.tensor([1.0, 4.0, 6.0, 4.0, 1.0], device=gray.device) / 16
    gray = F.conv2d(F.pad(gray, (2, 2, 0, 0), mode="replicate"), kernel.view(1, 1, 1, 5))
    return F.conv2d(F.pad(gray, (0, 0, 2, 2), mode="replicate"), kernel.view(1, 1, 5, 1))
