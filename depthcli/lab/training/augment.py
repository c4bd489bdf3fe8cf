"""Augmentation that keeps depth metric: random views of an image and the depth that follows.

All views have the same focal length, in pixels of the network's input. So, by the pinhole camera
model, zooming in by s divides depth by s, a view with another aspect ratio shows less of the image,
and an off-centre view is either a crop or the view of a rotated camera.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

from depthcli.lab.datasets.training_data import NYU_HFOV_DEG
from depthcli.lab.training.config import DataConfig

_SIDE_RANGE = (0.25, 0.75)  # of the rectangle, as fractions of the view's sides
_WHOLE_SHARE = 0.25  # fraction of views without zoom, like images at inference
_FULL_ROTATION_ZOOM = 0.2  # a zoom of 1.2 leaves room for the largest rotation
_CROP_286 = 286 / 256
_HALF_WIDTH = math.tan(math.radians(NYU_HFOV_DEG / 2))  # half of the image's width at depth 1
_LEAST_Z = 0.1  # a ray with less leaves an image of up to 168°; behind it, depth is negative
_ALL_VALID = 0.999  # least interpolated mask of a valid pixel
_MAX_BORDER = 0.03  # as a fraction of half the image; NYU Depth v2's is .029


def cutmix(
    maps: Sequence[Tensor | None], share: float, random: torch.Generator
) -> list[Tensor | None]:
    """Paste a rectangle of each view's neighbour in the batch into a share of the views.

    It keeps its depth but not its surroundings, so the network cannot infer depth from these
    (CutMix, Yun et al. 2019, but labels are mixed per pixel). The maps are (B, C, H, W) or None.
    """
    sources = [values for values in maps if values is not None]
    count, _, height, width = sources[0].shape
    chosen = torch.rand(count, generator=random) < share
    drawn = torch.rand(4, count, generator=random).tolist()
    mixed = [None if values is None else values.clone() for values in maps]
    for i in chosen.nonzero()[:, 0].tolist():
        columns = _pixel_range(drawn[0][i], drawn[1][i], width)
        rows = _pixel_range(drawn[2][i], drawn[3][i], height)
        for new, values in zip(filter(torch.is_tensor, mixed), sources, strict=True):
            new[i, :, rows, columns] = values[i - 1, :, rows, columns]
    return mixed


def _pixel_range(size: float, place: float, length: int) -> slice:
    """A random range of ``length`` pixels, for draws ``size`` and ``place`` in [0, 1)."""
    least, most = _SIDE_RANGE
    extent = least + (most - least) * size
    start = place * (1 - extent)
    return slice(*(math.ceil(end * length - 0.5) for end in (start, start + extent)))


class Geometry(NamedTuple):
    """Sampling grid and depth scale of some views."""

    grid: Tensor  #: (B, H, W, 2) float32, (x, y) in the images, [-1, 1] from edge to edge
    #: (B, 1, 1, 1) or (B, 1, H, W) float32, depth in the view per depth in the image
    depth_scale: Tensor
    #: (B, 1, H, W) bool, False where the view leaves the image; None if it never does
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
    """Sample views of ``size`` (width, height) px from images stretched to the network's input.

    ``tan_half_fov`` (``count``, 2) float64 is the tangent of half of each image's angle of view,
    across and down; None is NYU's across, and square pixels of the input.
    """
    if tan_half_fov is None:
        down = _HALF_WIDTH * data.height / data.width
        tan_half_fov = torch.tensor([[_HALF_WIDTH, down]], dtype=torch.float64)
    aspect = (tan_half_fov[:, 0] / tan_half_fov[:, 1]).float()
    cover = torch.tensor([size[0] / data.width, size[1] / data.height])
    zoom = torch.full((count,), _CROP_286)
    if not data.crop_286:
        zoom = torch.exp(torch.rand(count, generator=random) * math.log(data.zoom))
        zoom[torch.rand(count, generator=random) < _WHOLE_SHARE] = 1
    zoom = zoom * max(1.0, float(cover.max()))  # the view fits into the image
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


def _affine(
    zoom: Tensor, cover: Tensor, aspect: Tensor, data: DataConfig, random: torch.Generator
) -> Tensor:
    """Affine maps (B, 2, 3) from view to image coordinates; views lie inside the image."""
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
    """Image coordinates of each pixel of the views, (B, H, W, 2) in [-1, 1]."""
    # F.affine_grid gives the same, but its batched matrix product takes 1.4 ms of a 190 ms step.
    x = (torch.arange(width) * 2 + 1) / width - 1
    y = (torch.arange(height) * 2 + 1) / height - 1
    along_x, along_y, shift = view[:, None, None].unbind(-1)
    return along_x * x[:, None] + (along_y * y[:, None, None] + shift)


def _rotate_camera(grid: Tensor, shift: Tensor, halves: Tensor) -> tuple[Tensor, Tensor]:
    """Replace a shift (B, 2) by a camera rotation; the new grid, and z of each ray (B, H, W).

    It is the smallest that takes the optical axis to the centre of the view. ``halves`` (B, 2) is
    half the width and height of the images at depth 1.
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
    """Random views of RGB (B, 3, h, w) in [0, 1], metres and mask (B, 1, h, w); a size is drawn."""
    size = view_size(data, random) if size is None else size
    geometry = draw_views(len(rgb), size, data, random, tan_half_fov)
    grid = geometry.grid.to(rgb.device)
    if data.colour_jitter:
        gain = torch.exp(torch.randn((len(rgb), 3, 1, 1), generator=random) * data.colour_jitter)
        rgb = rgb * gain.to(rgb.device)
    gray = _gray(rgb, data)  # before resampling, as at inference
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
    return Views(*cutmix(views, data.cutmix, random)) if data.cutmix else views  # type: ignore[arg-type]


def to_network_input(rgb: Tensor, data: DataConfig) -> Tensor:
    """The gray network input (B, 1, H, W) in [-1, 1] of RGB (B, 3, H, W) in [0, 1]."""
    return _gray(rgb, data) * 2 - 1


def _gray(rgb: Tensor, data: DataConfig) -> Tensor:
    if data.colour == "luma":
        weights = torch.tensor([0.299, 0.587, 0.114], device=rgb.device).view(1, 3, 1, 1)
        return (rgb * weights).sum(1, keepdim=True)
    return rgb if data.colour == "rgb" else rgb.amax(1, keepdim=True)


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
    inner = grid.clamp(-limit, limit)
    sampled = F.grid_sample(gray, inner, padding_mode="border", align_corners=False)
    outer = (grid.abs() > 1 - width).any(-1)[:, None]
    return torch.where(outer & painted, level, sampled)


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
        if gray.is_cuda:  # so much is drawn there
            seed = int(torch.randint(2**62, (), generator=random))
            random = torch.Generator(gray.device).manual_seed(seed)
        noise = torch.randn(gray.shape, generator=random, device=random.device)
        gray = noise.mul_(strength).add_(gray)
    return gray.clamp(0, 1).mul_(2).sub_(1)


def _binomial_blur(gray: Tensor) -> Tensor:
    """The binomial filter [1, 4, 6, 4, 1] / 16 along both axes."""
    kernel = torch.tensor([1.0, 4.0, 6.0, 4.0, 1.0], device=gray.device) / 16
    count = gray.shape[1]
    across, down = (kernel.view(1, 1, *shape).repeat(count, 1, 1, 1) for shape in ((1, 5), (5, 1)))
    gray = F.conv2d(F.pad(gray, (2, 2, 0, 0), mode="replicate"), across, groups=count)
    return F.conv2d(F.pad(gray, (0, 0, 2, 2), mode="replicate"), down, groups=count)
