"""Known depth beside the image: a correction of a trained network, learned from pairs."""

from typing import ClassVar

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.lab.training.config import PAIRED_LOSSES, TrainConfig
from depthcli.lab.training.data import TrainingBatch
from depthcli.lab.training.losses import full_precision
from depthcli.lab.training.methods.base import Method, Phase, required
from depthcli.lab.training.networks.build import build_network
from depthcli.lab.training.networks.prompted import PromptedGenerator, coded_prompt

_NEARER = 0.5  # share of views whose farthest parts are made nearer
_NODES = 4, 5, 6  # of random errors: in depth, rows and columns


class Prompted(Method):
    """L1 and the other losses against truth; the trained network itself does not change.

    It errs less on pairs that it has seen than it will on others: so random errors are added to its
    output, and what is far away is made nearer.
    """

    TERMS: ClassVar = frozenset({"l1", "custom", *PAIRED_LOSSES})
    PAIRED: ClassVar = True
    phases: tuple[Phase, ...] = ("generator",)
    generator: PromptedGenerator  # type: ignore[assignment]

    def __init__(self, config: TrainConfig) -> None:
        super().__init__(config)
        self.generator = build_network(config.generator, config.data.channels)  # type: ignore[assignment]

    def networks(self, phase: Phase) -> list[nn.Module]:
        """The added layers of G."""
        del phase
        return [self.generator.correction]

    def forward(self, batch: TrainingBatch, phase: Phase) -> dict[str, Tensor]:
        """Weighted terms of the output with known depth."""
        del phase
        prompt, mask = coded_prompt(required(batch.prompt_m), self.codec)
        maps, raw = self.generator.plain(batch.network_input)
        if self.config.prompt.base_errors:
            errors = random_errors(raw) * (self.config.prompt.base_errors / self.codec.scale)
            raw = nearer_far_away(raw + errors)
        prediction = self.generator.correction(batch.network_input, maps, raw, prompt, mask).float()
        return self.paired_terms(prediction, self.encode(batch.depth_m), batch.valid_mask)


def random_errors(raw: Tensor) -> Tensor:
    """Errors that are smooth on each surface: (B, 1, H, W) of raw depth (B, 1, H, W).

    They are interpolated over columns, rows and depth; their scale in a view is normal, too.
    """
    count, _, height, width = raw.shape
    nodes = torch.randn((count, 1, *_NODES), device=raw.device)
    nodes = nodes * torch.randn((count, 1, 1, 1, 1), device=raw.device)
    low, high = raw.amin((2, 3), keepdim=True), raw.amax((2, 3), keepdim=True)
    depth = (raw - low) / (high - low + 1e-6) * 2 - 1
    y, x = (torch.linspace(-1, 1, n, device=raw.device) for n in (height, width))
    rows, columns = torch.meshgrid(y, x, indexing="ij")
    at = torch.stack([columns + 0 * depth[:, 0], rows + 0 * depth[:, 0], depth[:, 0]], -1)
    with full_precision(raw):
        errors = F.grid_sample(nodes, at[:, None], align_corners=True)
    return errors[:, :, 0]


def nearer_far_away(raw: Tensor) -> Tensor:
    """Raw depth (B, 1, H, W), compressed from a random depth on in half of the views.

    A network tends to see the farthest parts of new images too near.
    """
    begin, share, is_chosen = torch.rand((3, len(raw), 1, 1, 1), device=raw.device)
    low, high = raw.amin((2, 3), keepdim=True), raw.amax((2, 3), keepdim=True)
    beyond = F.relu(raw - low - begin * (high - low))
    return raw - share * (is_chosen < _NEARER) * beyond  # type: ignore[no-any-return]
