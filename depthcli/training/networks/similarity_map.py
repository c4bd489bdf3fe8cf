"""The network m of SimDCL: all patch vectors of an image to one vector (Han et al. 2021)."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.training.losses.precision import full_precision
from depthcli.training.networks.weights import init_xavier


class SimilarityMap(nn.Module):
    """Convolution, ReLU, global average, Linear, ReLU, Linear, L2-normalize.

    Its init weights are small, as in all networks of the CUT family, so that its output, of
    ``dim`` channels, underflows half precision before it is normalized.
    """

    def __init__(self, taps: int, dim: int = 64) -> None:
        super().__init__()
        self.conv = nn.Conv2d(taps, dim, 3, 2)
        self.linear = nn.Sequential(nn.Linear(dim, dim), nn.ReLU(), nn.Linear(dim, dim))
        init_xavier(self)

    def forward(self, vectors: Sequence[Tensor]) -> Tensor:
        """One unit vector (B, dim) per image, fp32, of the vectors (B, P, C) fp32 of each tap.

        P and C are at least 3. Of all taps, as many patches are used as the smallest map has.
        """
        patches = min(v.shape[1] for v in vectors)
        with full_precision(vectors[0]):
            stacked = torch.stack([v[:, :patches] for v in vectors], 1)
            pooled = F.relu(self.conv(stacked)).mean((2, 3))
            return F.normalize(self.linear(pooled), dim=1)
