"""Known depth for training: a pattern with errors for each view."""

import math

import numpy as np
import torch
from torch import Tensor

from depthcli.lab.datasets.prompts import WHOLE, Part, Pattern, Prompt
from depthcli.lab.training.augment import Views
from depthcli.lab.training.config import PromptConfig

_NOISY = 0.5  # share of prompts with noise, of those with errors
_PART_SIDES = 0.25, 0.8  # of the part of an image that has points


def drawn_prompts(views: Views, config: PromptConfig, seed: np.random.SeedSequence) -> Tensor:
    """Known depth of each view, (B, 1, H, W) metres, 0 where nothing is known."""
    random = np.random.default_rng(seed)
    depth_m = views.depth_m if views.valid_mask is None else views.depth_m * views.valid_mask
    maps_m, grays = (
        tensor.float().mean(1).cpu().numpy() for tensor in (depth_m, views.network_input)
    )
    drawn = [
        drawn_prompt(config, random).draw(map_m, gray, random)
        for map_m, gray in zip(maps_m, grays, strict=True)
    ]
    return torch.from_numpy(np.stack(drawn))[:, None].to(depth_m.device)


def drawn_prompt(config: PromptConfig, random: np.random.Generator) -> Prompt:
    """A pattern of known depth with its errors."""
    pattern = Pattern(config.patterns[random.integers(len(config.patterns))])
    if pattern is Pattern.LIDAR:
        size = config.lines[random.integers(len(config.lines))]
    else:
        least, most = {
            Pattern.UNIFORM: config.points,
            Pattern.CORNERS: config.corners,
            Pattern.CAMERA: config.columns,
        }[pattern]
        size = round(_between(least, most, random))
    range_m = _between(*config.range_m, random)
    part = _drawn_part(random) if random.random() < config.missing else WHOLE
    if random.random() < config.exact:
        return Prompt(pattern, size, jitter_px=config.jitter_px, part=part, range_m=range_m)
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
        range_m=range_m,
    )


def _between(least: float, most: float, random: np.random.Generator) -> float:
    """A number between two, whose logarithm is uniform."""
    return math.exp(random.uniform(math.log(least), math.log(most)))


def _drawn_part(random: np.random.Generator) -> Part:
    width, height = random.uniform(*_PART_SIDES, 2)
    left, top = random.random(2) * (1 - width, 1 - height)
    return left, top, left + width, top + height
