"""The heads H that turn feature maps into patch vectors for PatchNCE (Park et al. 2020)."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from depthcli.training.networks.weights import init_xavier

_EPSILON = 1e-7


class PatchSampler(nn.Module):
    """Per tap: Linear, ReLU, Linear, L2-normalize, at random positions.

    Args:
        channels: of each tap.
        dim: length of a patch vector.
        patches: positions per map; all of them if the map has fewer.
    """

    def __init__(self, channels: Sequence[int], dim: int = 256, patches: int = 256) -> None:
        super().__init__()
        self.patches = patches
        self.heads = nn.ModuleList(
            nn.Sequential(nn.Linear(width, dim), nn.ReLU(), nn.Linear(dim, dim))
            for width in channels
        )
        init_xavier(self)

    def forward(
        self, maps: Sequence[Tensor], positions: Sequence[Tensor] | None = None
    ) -> tuple[list[Tensor], list[Tensor]]:
        """Unit patch vectors (B, P, dim) of each tap's map (B, C, H, W), and the positions used.

        ``positions`` are flat indices (P,) per tap, for queries those of their keys; None samples
        new ones without replacement.
        """
        if positions is None:
            positions = [self._draw(m) for m in maps]
        vectors = []
        for head, features, chosen in zip(self.heads, maps, positions, strict=True):
            patches = head(features.flatten(2)[:, :, chosen].transpose(1, 2)).float()
            vectors.append(patches / (patches.norm(dim=2, keepdim=True) + _EPSILON))
        return vectors, list(positions)

    def _draw(self, features: Tensor) -> Tensor:
        return torch.randperm(features[0, 0].numel(), device=features.device)[: self.patches]
