"""Details of one network, low frequencies of another that sees the image at half the size."""

from typing import Any

import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

_WINDOW = 17  # pixels of the coarse map: an eighth of the width of 256-pixel inputs


class TwoScaleGenerator(nn.Module):
    """Raw depth of ``fine``, whose low frequencies are those of ``coarse`` at half the size.

    Both are generators of one kind, whose raw depth has the same coding.
    """

    def __init__(self, fine: nn.Module, coarse: nn.Module) -> None:
        super().__init__()
        self.fine, self.coarse, self.merge = fine, coarse, _Merge()
        self.channels: Any = getattr(fine, "channels", 1)

    def forward(self, x: Tensor) -> Tensor:
        """Raw depth of the size of ``fine``'s for x (B, C, H, W) in [-1, 1], of multiples of 4."""
        raw: Tensor = self.merge(self.fine(x), self.coarse(F.avg_pool2d(x, 2)))
        return raw


class _Merge(nn.Module):
    """A module, so that its operators have a scope of their own in the exported graph."""

    def forward(self, fine: Tensor, coarse: Tensor) -> Tensor:
        """Add the mean of coarse − fine over a window around each pixel to fine."""
        difference = coarse - F.avg_pool2d(fine, 2)
        for window in ((_WINDOW, 1), (1, _WINDOW)):
            padding = (window[0] // 2, window[1] // 2)
            difference = F.avg_pool2d(difference, window, 1, padding, count_include_pad=False)
        return fine + F.interpolate(difference, scale_factor=2.0, mode="bilinear")
