"""Instance norm for networks in channels-last memory."""

import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn


class InstanceNorm(nn.InstanceNorm2d):
    """Instance norm without affine parameters (Ulyanov et al. 2016).

    The gradients of torch's own (2.13 still) are wrong for one picture in channels-last memory. The
    batch norm of one picture, which is the same, is used instead, unless no gradients are needed,
    as for the export.
    """

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, C, H, W), each map with mean 0 and variance 1."""
        if len(x) == 1 and (self.training or x.requires_grad):
            return F.batch_norm(x, None, None, training=True, eps=self.eps)
        return super().forward(x)
