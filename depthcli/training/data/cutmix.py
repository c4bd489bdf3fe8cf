"""CutMix for depth: a rectangle of another view, pasted into both picture and depth.

A pasted rectangle keeps its depth but not its surroundings, so the network cannot infer the depth
from these.

Source: Yun et al., "CutMix: Regularization Strategy to Train Strong Classifiers with Localizable
Features", ICCV 2019; here labels are mixed per pixel, not by area.
"""

import math

import torch
from torch import Tensor

_SIDE_RANGE = (0.25, 0.75)  # of the rectangle, as fractions of the view's sides


def cutmix(maps: list[Tensor], share: float, random: torch.Generator) -> list[Tensor]:
    """Paste a rectangle of each view's neighbour in the batch into some of the views.

    The maps are (B, C, H, W), of the same views, and get the same rectangles; ``share`` is the
    probability per view. Returns maps of the same shapes and types.
    """
    count, _, height, width = maps[0].shape
    chosen = torch.rand(count, generator=random) < share
    drawn = torch.rand(4, count, generator=random).tolist()
    mixed = [values.clone() for values in maps]
    for i in chosen.nonzero()[:, 0].tolist():
        columns = _pixel_range(drawn[0][i], drawn[1][i], width)
        rows = _pixel_range(drawn[2][i], drawn[3][i], height)
        for new, values in zip(mixed, maps, strict=True):
            new[i, :, rows, columns] = values[i - 1, :, rows, columns]
    return mixed


def _pixel_range(size: float, place: float, length: int) -> slice:
    """A random range of ``length`` pixels, for draws ``size`` and ``place`` in [0, 1)."""
    least, most = _SIDE_RANGE
    extent = least + (most - least) * size
    start = place * (1 - extent)
    return slice(*(math.ceil(end * length - 0.5) for end in (start, start + extent)))
