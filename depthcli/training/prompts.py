"""Known depth for training: patterns and errors of each view, drawn on the device of a batch.

They are those of :mod:`depthcli.datasets.prompts`, but for numbers of uniform points, which are
right on average.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

from depthcli.datasets import prompts
from depthcli.datasets.prompts import Pattern, Prompt
from depthcli.training.augment import Views
from depthcli.training.config import PromptConfig

_NOISY = 0.5  # share of prompts with noise, of those with errors
_PART_SIDES = 0.25, 0.8  # of the part of an image that has points
_SOBEL = torch.tensor([[-1.0, 0.0, 1.0], [-2.0, 0.0, 2.0], [-1.0, 0.0, 1.0]]).view(1, 1, 3, 3)


def drawn_prompts(views: Views, config: PromptConfig, seed: np.random.SeedSequence) -> Tensor:
    """Known depth of each view, (B, 1, H, W) metres, 0 where nothing is known."""
    depth_m = views.depth_m[:, 0].float()
    if views.valid_mask is not None:
        depth_m = depth_m * views.valid_mask[:, 0]
    gray = views.network_input.float().mean(1)
    random = np.random.default_rng(seed)
    drawn = [drawn_prompt(config, random) for _ in depth_m]
    generator = torch.Generator(depth_m.device).manual_seed(int(random.integers(2**62)))
    is_known = _part(drawn, depth_m)
    for pattern in sorted({one.pattern for one in drawn}):
        rows = [i for i, one in enumerate(drawn) if one.pattern is pattern]
        at = torch.tensor(rows, device=depth_m.device)
        sizes = _column([drawn[i].size for i in rows], depth_m)
        is_known[at] &= _PLACES[pattern](sizes, depth_m[at], gray[at], generator)
    seen_m = _with_errors(_shifted(depth_m, drawn, generator), drawn, generator)
    return (seen_m * (is_known & (seen_m > 0)))[:, None]


def drawn_prompt(config: PromptConfig, random: np.random.Generator) -> Prompt:
    """A pattern of known depth with its errors."""
    pattern = Pattern(config.patterns[random.integers(len(config.patterns))])
    ends = {
        Pattern.UNIFORM: config.points,
        Pattern.CORNERS: config.corners,
        Pattern.CAMERA: config.columns,
        Pattern.LIDAR: (1, 1),
    }[pattern]
    size = round(math.exp(random.uniform(*np.log(ends))))
    if pattern is Pattern.LIDAR:
        size = config.lines[random.integers(len(config.lines))]
    part = _drawn_part(random) if random.random() < config.missing else (0.0, 0.0, 1.0, 1.0)
    if random.random() < config.exact:
        return Prompt(pattern, size, jitter_px=config.jitter_px, part=part)
    is_shifted = random.random() < config.shifted
    shift_px = random.uniform(-config.shift_px, config.shift_px, 2) * is_shifted
    return Prompt(
        pattern,
        size,
        noise=random.uniform(0, config.noise) * (random.random() < _NOISY),
        has_kinect_noise=random.random() < config.kinect,
        wrong=config.wrong[random.integers(len(config.wrong))],
        shift_px=(float(shift_px[0]), float(shift_px[1])),
        jitter_px=config.jitter_px,
        part=part,
    )


def _drawn_part(random: np.random.Generator) -> tuple[float, float, float, float]:
    """Left, top, right and bottom of a part of an image, as fractions of it."""
    width, height = random.uniform(*_PART_SIDES, 2)
    left, top = random.random(2) * (1 - width, 1 - height)
    return left, top, left + width, top + height


def _column(values: Sequence[float], like: Tensor) -> Tensor:
    """One value of each view, (B, 1, 1)."""
    return torch.tensor(values, dtype=torch.float32).to(like.device).view(-1, 1, 1)


def _grid(like: Tensor) -> tuple[Tensor, Tensor]:
    """Rows (1, H, 1) and columns (1, 1, W) of maps (B, H, W)."""
    y, x = (torch.arange(n, device=like.device) for n in like.shape[1:])
    return y[None, :, None], x[None, None]


def _read(values: Tensor, y: Tensor, x: Tensor) -> Tensor:
    """Values of maps (B, H, W) at rows and columns that broadcast to their shape."""
    height, width = values.shape[1:]
    index = y.long().clamp(0, height - 1) * width + x.long().clamp(0, width - 1)
    return values.flatten(1).gather(1, index.expand_as(values).flatten(1)).view_as(values)


def _part(drawn: Sequence[Prompt], depth_m: Tensor) -> Tensor:
    """Whether a pixel is in the part of its view that has points, (B, H, W)."""
    (height, width), (y, x) = depth_m.shape[1:], _grid(depth_m)
    left, top, right, bottom = (
        _column(side, depth_m) for side in zip(*(one.part for one in drawn), strict=True)
    )
    return (x >= left * width) & (x < right * width) & (y >= top * height) & (y < bottom * height)


def _shifted(depth_m: Tensor, drawn: Sequence[Prompt], random: torch.Generator) -> Tensor:
    """Depth as it is seen at each pixel, beside its place."""
    place = []
    for at, offsets in zip(
        _grid(depth_m)[::-1], zip(*(one.shift_px for one in drawn), strict=True), strict=True
    ):
        jitter = torch.randn(depth_m.shape, generator=random, device=depth_m.device)
        jitter = jitter * _column([one.jitter_px for one in drawn], depth_m)
        place.append(at + (_column(offsets, depth_m) + jitter).round())
    return _read(depth_m, place[1], place[0])


def _with_errors(seen_m: Tensor, drawn: Sequence[Prompt], random: torch.Generator) -> Tensor:
    def uniform() -> Tensor:
        return torch.rand(seen_m.shape, generator=random, device=seen_m.device)

    noise_m = _column([one.noise for one in drawn], seen_m) * seen_m
    of_kinect = _column([one.has_kinect_noise for one in drawn], seen_m) > 0
    noise_m = torch.where(of_kinect, prompts.kinect_noise_m(seen_m), noise_m)
    is_known = seen_m > 0
    normal = torch.randn(seen_m.shape, generator=random, device=seen_m.device)
    noisy_m = (seen_m + noise_m * normal) * is_known
    is_wrong = uniform() < _column([one.wrong for one in drawn], seen_m)
    low, high = prompts.WRONG_RATIO
    ratio = low + (high - low) * uniform()
    ratio = torch.where(uniform() < prompts.NEARER, 1 / ratio, ratio)
    return torch.where(is_wrong, noisy_m * ratio, noisy_m)


def _uniform(sizes: Tensor, depth_m: Tensor, gray: Tensor, random: torch.Generator) -> Tensor:
    del gray
    is_place = depth_m > 0
    share = sizes / is_place.sum((1, 2), keepdim=True).clamp(min=1)
    return is_place & (torch.rand(depth_m.shape, generator=random, device=depth_m.device) < share)


def _lidar(sizes: Tensor, depth_m: Tensor, gray: Tensor, random: torch.Generator) -> Tensor:
    del gray
    (height, width), (y, x) = depth_m.shape[1:], _grid(depth_m)
    drawn = torch.rand((3, len(depth_m), 1, 1), generator=random, device=depth_m.device)
    slope = prompts.SLOPE * (2 * drawn[0] - 1)
    density = prompts.LEAST_DENSITY + (1 - prompts.LEAST_DENSITY) * drawn[1]
    step = height / sizes
    line = (y - slope * (x - width / 2)) / step - drawn[2]
    is_line = (line - line.round()).abs() * step <= 0.5  # noqa: PLR2004 - half a pixel
    is_seen = torch.rand(depth_m.shape, generator=random, device=depth_m.device) < density
    return is_line & is_seen & (line.round() >= 0) & (line.round() < sizes)


def _camera(sizes: Tensor, depth_m: Tensor, gray: Tensor, random: torch.Generator) -> Tensor:
    del gray
    (height, width), (y, x) = depth_m.shape[1:], _grid(depth_m)
    columns = sizes.clamp(max=width)
    rows = (columns * height / width).round().clamp(min=1)
    is_sample = _is_sample(x, columns / width) & _is_sample(y, rows / height)
    log_depth = torch.where(depth_m > 0, depth_m, 1.0).log()
    low = high = log_depth
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            beside = _read(log_depth, y + dy * height / rows, x + dx * width / columns)
            low, high = torch.minimum(low, beside), torch.maximum(high, beside)
    chosen = torch.rand(depth_m.shape, generator=random, device=depth_m.device)
    is_hole = (high - low > prompts.EDGE) & (chosen < prompts.EDGE_HOLES)
    return is_sample & (depth_m > 0) & (depth_m < prompts.CAMERA_RANGE_M) & ~is_hole


def _is_sample(at: Tensor, per_px: Tensor) -> Tensor:
    """Whether pixels contain the middle of a sample, of which there are ``per_px``."""
    first = (at * per_px - 0.5).ceil()
    return (first >= 0) & (first < (at + 1) * per_px - 0.5)


def _corners(sizes: Tensor, depth_m: Tensor, gray: Tensor, random: torch.Generator) -> Tensor:
    del random
    side = prompts.CORNER_PX
    sobel = _SOBEL.to(gray.device)
    padded = F.pad(gray[:, None], (1, 1, 1, 1), mode="reflect")
    across, down = F.conv2d(padded, sobel), F.conv2d(padded, sobel.transpose(2, 3))
    xx, xy, yy = (F.avg_pool2d(v, side, 1, side // 2) for v in (across**2, across * down, down**2))
    response = ((xx + yy) / 2 - (((xx - yy) / 2) ** 2 + xy**2).sqrt())[:, 0]
    is_corner = response == F.max_pool2d(response, side, 1, side // 2)
    strength = torch.where(is_corner & (depth_m > 0), response, -1.0)
    best = strength.flatten(1).topk(min(int(sizes.max()), strength[0].numel())).values
    least = best.gather(1, (sizes.view(-1, 1).long() - 1).clamp(max=best.shape[1] - 1))
    return (strength >= least[:, :, None]) & (strength >= 0)


_PLACES: dict[Pattern, Callable[[Tensor, Tensor, Tensor, torch.Generator], Tensor]] = {
    Pattern.UNIFORM: _uniform,
    Pattern.LIDAR: _lidar,
    Pattern.CAMERA: _camera,
    Pattern.CORNERS: _corners,
}
