"""Multi-scale gradient matching (Li and Snavely 2018), which sharpens depth edges."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
import torch.nn.functional as F  # noqa: N812

if TYPE_CHECKING:
    from torch import Tensor

SCALES = 4


def gradient_loss(prediction: Tensor, truth: Tensor) -> Tensor:
    """Mean over scales of mean |∂x e| + mean |∂y e|, with e = prediction − truth; a scalar.

    Args:
        prediction: (B, 1, H, W), coded depth; H and W at least 16, so that every scale has a
            difference.
        truth: (B, 1, H, W), coded depth.
    """
    error = prediction - truth
    terms = []
    for _ in range(SCALES):
        along_x = (error[..., 1:] - error[..., :-1]).abs().mean()
        along_y = (error[..., 1:, :] - error[..., :-1, :]).abs().mean()
        terms.append(along_x + along_y)
        error = F.avg_pool2d(error, 2)
    return torch.stack(terms).mean()
