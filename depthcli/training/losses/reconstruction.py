"""Reconstruction of the hidden part of a picture (Xie et al. 2022, "SimMIM")."""

import torch.nn.functional as F  # noqa: N812
from torch import Tensor


def reconstruction_loss(output: Tensor, picture: Tensor, hidden: Tensor) -> Tensor:
    """Mean |output − picture| over hidden pixels; a scalar, 0 if none is hidden.

    Args:
        output: (B, 1, h, w), at most as large as the picture.
        picture: (B, 1, H, W) in [-1, 1]; compared at the output's size, by area.
        hidden: (B, 1, H, W) bool; a pixel of the output counts by the share of it that is hidden.
    """
    size = output.shape[2:]
    weight = F.interpolate(hidden.float(), size=size, mode="area")
    distance = (output - F.interpolate(picture, size=size, mode="area")).abs()
    return (distance * weight).sum() / weight.sum().clamp(min=1)
