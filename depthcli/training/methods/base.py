"""What every method is to the training loop."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Literal

from torch import nn

if TYPE_CHECKING:
    from torch import Tensor

    from depthcli.training.batches import Batch
    from depthcli.training.config import TrainConfig

Phase = Literal["generator", "discriminator"]


class Method(nn.Module):
    """Networks and losses of one method; the loop knows nothing else about it.

    ``forward(batch, phase)`` returns the weighted loss terms of a phase, which the loop adds up
    and minimises over the networks of that phase.

    Attributes:
        phases: the order of the two half steps.
        generator: the network that is validated and exported.
    """

    phases: tuple[Phase, ...]
    generator: nn.Module

    def __init__(self, config: TrainConfig) -> None:
        super().__init__()
        self.config = config

    @abstractmethod
    def networks(self, phase: Phase) -> list[nn.Module]:
        """The networks that a phase moves; none if the phase has nothing to do."""

    @abstractmethod
    def forward(self, batch: Batch, phase: Phase) -> dict[str, Tensor]:
        """Weighted loss terms by name, each a scalar."""

    def extra_state(self) -> dict[str, list[Tensor]]:
        """State beyond the networks' weights, such as image pools, by name."""
        return {}

    def load_extra_state(self, state: dict[str, list[Tensor]]) -> None:
        """Take up what :meth:`extra_state` returned."""
