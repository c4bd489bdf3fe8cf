"""CutMix for depth: a rectangle of another pair's view, pasted into picture and depth alike.

A pasted piece keeps its metres, but not its place in the room, so neither the place nor the rest of
the room gives its depth away.

Source: Yun et al., "CutMix: Regularization Strategy to Train Strong Classifiers with Localizable
Features", ICCV 2019; here the labels are mixed by the pixel, not by the share.
"""

import math

import torch
from torch import Tensor

_SIDES = (0.25, 0.75)  # of the rectangle, as shares of the view's


def cutmix(maps: list[Tensor], share: float, random: torch.Generator) -> list[Tensor]:
    """Paste a rectangle of each view's neighbour in the batch into some of the views.

    Each of the maps is (B, C, H, W), of the same views, and gets the same rectangles, a view with
    the probability ``share``; the new maps have the same shapes and types.
    """
    count, _, height, width = maps[0].shape
    chosen = torch.rand(count, generator=random) < share
    drawn = torch.rand(4, count, generator=random).tolist()
    mixed = [values.clone() for values in maps]
    for i in chosen.nonzero()[:, 0].tolist():
        columns = _stretch(drawn[0][i], drawn[1][i], width)
        rows = _stretch(drawn[2][i], drawn[3][i], height)
        for new, values in zip(mixed, maps, strict=True):
            new[i, :, rows, columns] = values[i - 1, :, rows, columns]
    return mixed


def _stretch(size: float, place: float, length: int) -> slice:
    """The pixels whose centres lie in a stretch of ``length`` pixels, for draws in [0, 1)."""
    least, most = _SIDES
    extent = least + (most - least) * size
    start = place * (1 - extent)
    return slice(*(math.ceil(end * length - 0.5) for end in (start, start + extent)))
