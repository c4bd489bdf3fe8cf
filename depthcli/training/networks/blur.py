"""Antialiased downsampling (Zhang 2019), as in the CUT family."""

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn


class BlurDown(nn.Module):
    """Depthwise [1, 2, 1]² filter with stride 2 and reflection padding."""

    kernel: Tensor

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.register_buffer("kernel", _kernel([1.0, 2.0, 1.0], channels), persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, C, ceil(H/2), ceil(W/2))."""
        x = F.pad(x, (1, 1, 1, 1), mode="reflect")
        return F.conv2d(x, self.kernel.to(x.dtype), stride=2, groups=x.shape[1])


def _kernel(taps: list[float], channels: int) -> Tensor:
    line = torch.tensor(taps)
    square = torch.outer(line, line) / line.sum() ** 2
    return square.expand(channels, 1, -1, -1).clone()
