"""CutMix for depth: a rectangle of another pair's view, pasted into picture and depth alike.

A pasted piece keeps its metres, but not its place in the room, so neither the place nor the rest of
the room gives its depth away.

Source: Yun et al., "CutMix: Regularization Strategy to Train Strong Classifiers with Localizable
Features", ICCV 2019; here the labels are mixed by the pixel, not by the share.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from torch import Tensor

_SIDES = (0.25, 0.75)  # of the rectangle, as shares of the view's


def cutmix(maps: list[Tensor], share: float, random: torch.Generator) -> list[Tensor]:
    """Paste a rectangle of each view's neighbour in the batch into some of the views.

    Args:
        maps: each (B, C, H, W), of the same views; all get the same rectangles.
        share: probability in [0, 1] that a view gets one.
        random: the only source of chance.

    Returns:
        New maps of the same shapes and types.
    """
    count, _, height, width = maps[0].shape
    chosen = torch.rand(count, generator=random) < share
    drawn = torch.rand(4, count, 1, generator=random)
    inside_x = _stretch(drawn[0], drawn[1], width)
    inside_y = _stretch(drawn[2], drawn[3], height)
    inside = inside_y[:, :, None] & inside_x[:, None, :] & chosen[:, None, None]
    inside = inside[:, None].to(maps[0].device)
    return [torch.where(inside, values.roll(1, 0), values) for values in maps]


def _stretch(size: Tensor, place: Tensor, length: int) -> Tensor:
    """Which of ``length`` pixels lie in a stretch, (B, length), for draws (B, 1) in [0, 1)."""
    least, most = _SIDES
    extent = least + (most - least) * size
    start = place * (1 - extent)
    centres = (torch.arange(length) + 0.5) / length
    return (centres >= start) & (centres < start + extent)
