"""Known depth beside the image: a correction of a trained network, learned from pairs."""

from typing import ClassVar

from torch import Tensor, nn

from depthcli.training.config import PAIRED_LOSSES, TrainConfig
from depthcli.training.data import TrainingBatch
from depthcli.training.methods.base import Method, Phase, required
from depthcli.training.networks.build import build_network
from depthcli.training.networks.prompted import PromptedGenerator, coded_prompt


class Prompted(Method):
    """L1 and the other losses against truth; the trained network itself does not change."""

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
        made = self.generator(batch.network_input, prompt, mask).float()
        return self.paired_terms(made, self.encode(batch.depth_m), batch.valid_mask)
