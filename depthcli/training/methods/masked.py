"""Masked pictures (He et al. 2022, Xie et al. 2022): what a network learns without any depth."""

import math
from typing import ClassVar

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.training.config import TrainConfig
from depthcli.training.data import TrainingBatch
from depthcli.training.losses import reconstruction_loss
from depthcli.training.methods.base import Method, Phase

_BLOCKS_ACROSS = 12  # hidden blocks are a twelfth of the picture's width


class Masked(Method):
    """Predict the blocks of a picture that are hidden; a start for other methods.

    The generator learns all of its layers but the last one, which keeps its init weights: here
    another last layer, ``reconstruct``, is in its place.
    """

    TERMS: ClassVar = frozenset({"reconstruction"})
    PAIRED: ClassVar = True
    DEPTH: ClassVar = False
    phases: tuple[Phase, ...] = ("generator",)

    def __init__(self, config: TrainConfig) -> None:
        super().__init__(config)
        self.reconstruct = nn.Conv2d(self.generator.last_channels, 1, 3, padding=1)

    def networks(self, phase: Phase) -> list[nn.Module]:
        """G, and the layer in place of its last one, which gets no gradient."""
        del phase
        return [self.generator, self.reconstruct]

    def forward(self, batch: TrainingBatch, phase: Phase) -> dict[str, Tensor]:
        """The only term."""
        del phase
        hidden = hidden_blocks(batch.network_input, self.weights.hidden)
        output = self.reconstruct(
            self.generator.last_features(batch.network_input.masked_fill(hidden, 0))
        )
        loss = reconstruction_loss(output.float(), batch.network_input, hidden)
        return {"reconstruction": self.weights.reconstruction * loss}


def hidden_blocks(picture: Tensor, share: float) -> Tensor:
    """Random blocks (B, 1, H, W) bool of a picture of that shape, each with probability ``share``.

    >>> hidden_blocks(torch.zeros(1, 1, 36, 48), 1.0).all().item()
    True
    """
    batch, _, height, width = picture.shape
    side = math.ceil(width / _BLOCKS_ACROSS)
    grid = (batch, 1, math.ceil(height / side), math.ceil(width / side))
    blocks = (torch.rand(grid, device=picture.device) < share).float()
    return F.interpolate(blocks, scale_factor=side)[..., :height, :width].bool()
