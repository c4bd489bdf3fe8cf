"""Networks on patches: PatchGAN (Isola et al. 2017), patch heads, and SimDCL's map of them."""

import itertools
from collections.abc import Sequence

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.lab.training.losses import full_precision
from depthcli.lab.training.networks.resnet import BlurDown, InstanceNorm, init_weights

_SLOPE = 0.2
_EPSILON = 1e-7


class PatchGan(nn.Module):
    """One logit for every 70×70 patch of an image of ``channels``.

    The ``width`` of the first layer is doubled three times. ``antialias`` replaces strides by blur
    (the CUT family).
    """

    def __init__(self, channels: int = 1, *, width: int = 64, antialias: bool = False) -> None:
        super().__init__()
        widths = (channels, width, 2 * width, 4 * width, 8 * width)
        layers: list[nn.Module] = []
        for i, (inputs, outputs) in enumerate(itertools.pairwise(widths)):
            shrinks = i < 3  # noqa: PLR2004 - the last two layers keep the size
            stride = 2 if shrinks and not antialias else 1
            layers.append(nn.Conv2d(inputs, outputs, 4, stride, 1))
            if i:
                layers.append(InstanceNorm(outputs))
            layers.append(nn.LeakyReLU(_SLOPE))
            if shrinks and antialias:
                layers.append(BlurDown(outputs))
        layers.append(nn.Conv2d(widths[-1], 1, 4, 1, 1))
        self.layers = nn.Sequential(*layers)
        init_weights(self, xavier=antialias)

    def forward(self, image: Tensor) -> Tensor:
        """Logits of an image: (B, channels, 256, 256) to (B, 1, 30, 30), and so on."""
        return self.layers(image)  # type: ignore[no-any-return]


class PatchSampler(nn.Module):
    """Per tap: Linear, ReLU, Linear, L2-normalize, at random positions, or all of a small map."""

    def __init__(self, channels: Sequence[int], dim: int = 256, patches: int = 256) -> None:
        super().__init__()
        self.patches = patches
        self.heads = nn.ModuleList(
            nn.Sequential(nn.Linear(width, dim), nn.ReLU(), nn.Linear(dim, dim))
            for width in channels
        )
        init_weights(self, xavier=True)

    def forward(
        self, maps: Sequence[Tensor], positions: Sequence[Tensor] | None = None
    ) -> tuple[list[Tensor], list[Tensor]]:
        """Unit patch vectors (B, P, dim) of each tap's map (B, C, H, W), and the positions used.

        These are flat indices (P,) per tap: for queries those of their keys, else new random ones.
        """
        if positions is None:
            positions = [
                torch.randperm(m[0, 0].numel(), device=m.device)[: self.patches] for m in maps
            ]
        vectors = []
        for head, features, chosen in zip(self.heads, maps, positions, strict=True):
            patches = head(features.flatten(2)[:, :, chosen].transpose(1, 2)).float()
            vectors.append(patches / (patches.norm(dim=2, keepdim=True) + _EPSILON))
        return vectors, list(positions)


class SimilarityMap(nn.Module):
    """Convolution, ReLU, global average, Linear, ReLU, Linear, L2-normalize.

    Its init weights are so small that the output underflows half precision before it is normalized.
    """

    def __init__(self, taps: int, dim: int = 64) -> None:
        super().__init__()
        self.conv = nn.Conv2d(taps, dim, 3, 2)
        self.linear = nn.Sequential(nn.Linear(dim, dim), nn.ReLU(), nn.Linear(dim, dim))
        init_weights(self, xavier=True)

    def forward(self, vectors: Sequence[Tensor]) -> Tensor:
        """One unit vector (B, dim) per image, fp32, of the vectors (B, P, C) fp32 of each tap.

        P and C are at least 3. Of all taps, as many patches are used as the smallest map has.
        """
        patches = min(v.shape[1] for v in vectors)
        with full_precision(vectors[0]):
            stacked = torch.stack([v[:, :patches] for v in vectors], 1)
            pooled = F.relu(self.conv(stacked)).mean((2, 3))
            return F.normalize(self.linear(pooled), dim=1)
