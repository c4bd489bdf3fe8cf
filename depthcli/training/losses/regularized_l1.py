"""Regularized L1 (eq. 1)."""

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn


def regularized_l1(
    prediction: Tensor,
    truth: Tensor,
    generator: nn.Module,
    penalty: float,
    valid_mask: Tensor | None = None,
) -> Tensor:
    """Mean |prediction − truth| + penalty · Σ‖convolution weights‖²; a scalar.

    Args:
        prediction: (B, 1, H, W), coded depth.
        truth: (B, 1, H, W), coded depth.
        generator: whose convolution weights are penalized.
        penalty: λ of eq. 1; zero leaves the sum out.
        valid_mask: (B, 1, H, W) bool, the pixels that the mean is of; None for all.
    """
    if valid_mask is None:
        distance = F.l1_loss(prediction, truth)
    else:
        distance = masked_mean((prediction - truth).abs(), valid_mask)
    if not penalty:
        return distance
    return distance + penalty * torch.stack([(w**2).sum() for w in conv_weights(generator)]).sum()


def masked_mean(values: Tensor, valid_mask: Tensor) -> Tensor:
    """Mean of the values (B, 1, H, W) where ``valid_mask`` (bool, the same shape); 0 for none."""
    return (values * valid_mask).sum() / valid_mask.sum().clamp(min=1)


def conv_weights(network: nn.Module) -> list[Tensor]:
    """Kernels of every convolution, plain or transposed."""
    kinds = (nn.Conv2d, nn.ConvTranspose2d)
    return [layer.weight for layer in network.modules() if isinstance(layer, kinds)]
