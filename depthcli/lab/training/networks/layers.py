"""Layers of the GANs: blur (Zhang 2019), instance norm, and the initialization of weights."""

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

_STD = 0.02


class BlurDown(nn.Module):
    """Depthwise [1, 2, 1]² filter with stride 2 and reflection padding."""

    kernel: Tensor

    def __init__(self, channels: int) -> None:
        super().__init__()
        line = torch.tensor([1.0, 2.0, 1.0]) / 4
        kernel = torch.outer(line, line).expand(channels, 1, -1, -1).clone()
        self.register_buffer("kernel", kernel, persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, C, ceil(H/2), ceil(W/2))."""
        x = F.pad(x, (1, 1, 1, 1), mode="reflect")
        return F.conv2d(x, self.kernel.to(x.dtype), stride=2, groups=x.shape[1])


class InstanceNorm(nn.InstanceNorm2d):
    """Instance norm without affine parameters (Ulyanov et al. 2016).

    The gradients of torch's own (2.13 still) are wrong for one image in channels-last memory, so
    its batch norm, which is the same for one image, is used where gradients are needed.
    """

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, C, H, W), each map with mean 0 and variance 1."""
        if len(x) == 1 and (self.training or x.requires_grad):
            return F.batch_norm(x, None, None, training=True, eps=self.eps)
        return super().forward(x)


def init_weights(network: nn.Module, *, xavier: bool) -> None:
    """Kernels from N(0, 0.02²) (CycleGAN), or Xavier-normal of gain 0.02 (CUT); zero biases."""
    for layer in network.modules():
        if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d | nn.Linear):
            if xavier:
                nn.init.xavier_normal_(layer.weight, _STD)
            else:
                nn.init.normal_(layer.weight, 0.0, _STD)
            if layer.bias is not None:
                nn.init.zeros_(layer.bias)
