"""Multi-scale gradient matching (Li and Snavely 2018), which sharpens depth edges."""

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

from depthcli.training.losses.regularized_l1 import masked_mean

SCALES = 4


def gradient_loss(prediction: Tensor, truth: Tensor, valid_mask: Tensor | None = None) -> Tensor:
    """Mean over scales of mean |∂x e| + mean |∂y e|, with e = prediction − truth; a scalar.

    Args:
        prediction: (B, 1, H, W), coded depth; H and W at least 16, so that every scale has a
            difference.
        truth: (B, 1, H, W), coded depth.
        valid_mask: (B, 1, H, W) bool; the means are of differences between valid pixels, and a
            pixel of a coarser scale is valid if all that it covers are. None for all.
    """
    error, terms = prediction - truth, []
    for _ in range(SCALES):
        along_x = (error[..., 1:] - error[..., :-1]).abs()
        along_y = (error[..., 1:, :] - error[..., :-1, :]).abs()
        if valid_mask is None:
            terms.append(along_x.mean() + along_y.mean())
        else:
            both_x = valid_mask[..., 1:] & valid_mask[..., :-1]
            both_y = valid_mask[..., 1:, :] & valid_mask[..., :-1, :]
            terms.append(masked_mean(along_x, both_x) + masked_mean(along_y, both_y))
            valid_mask = F.avg_pool2d(valid_mask.float(), 2) == 1
        error = F.avg_pool2d(error, 2)
    return torch.stack(terms).mean()
