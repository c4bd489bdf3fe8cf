"""What every method is to the training loop, and what the methods share."""

from abc import abstractmethod
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import ClassVar, Literal, TypeVar

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.training.config.schema import TrainConfig
from depthcli.training.data.batches import TrainingBatch
from depthcli.training.networks.build import Generator, build_generator

Phase = Literal["generator", "discriminator"]
_Part = TypeVar("_Part")


class Method(nn.Module):
    """Networks and losses of one method; the loop knows nothing else about it.

    ``forward(batch, phase)`` returns the weighted loss terms of a phase, which the loop adds up
    and minimises over the networks of that phase.

    Attributes:
        TERMS: the weights of ``LossConfig`` that the method knows; others have to be zero.
        SETTINGS: of the settings that only some methods look at, those that this one does.
        PAIRED: whether it may be shown pictures and depth maps of one scene point together.
        phases: the order of the two half steps.
        generator: G, gray to depth: the network that is validated and exported.
        share_done: how much of the schedule is done, in [0, 1); the loop keeps it.
    """

    TERMS: ClassVar[frozenset[str]]
    SETTINGS: ClassVar[frozenset[str]] = frozenset()
    PAIRED: ClassVar[bool] = False
    phases: tuple[Phase, ...]

    def __init__(self, config: TrainConfig) -> None:
        super().__init__()
        self.config, self.weights = config, config.loss
        self.codec = config.output.codec
        self.share_done = 0.0
        self.generator: Generator = build_generator(config.generator)

    @abstractmethod
    def networks(self, phase: Phase) -> list[nn.Module]:
        """The networks that a phase moves; none if the phase has nothing to do."""

    def heads(self) -> list[nn.Module]:
        """Those of the networks that have a learning rate of their own, if one is set."""
        return []

    @abstractmethod
    def forward(self, batch: TrainingBatch, phase: Phase) -> dict[str, Tensor]:
        """Weighted loss terms by name, each a scalar."""

    def extra_state(self) -> dict[str, list[Tensor]]:
        """State beyond the networks' weights, such as image pools, by name."""
        return {}

    def load_extra_state(self, state: dict[str, list[Tensor]]) -> None:
        """Take up what :meth:`extra_state` returned."""

    def encode(self, depth_m: Tensor) -> Tensor:
        """Metres to the networks' coding, (B, 1, H, W) in [-1, 1]."""
        output = self.config.output
        nearest_m = output.min_m if output.coding == "log" else 0.0
        depth_m = depth_m.clamp(nearest_m, output.max_m)
        t = torch.log(depth_m) if output.coding == "log" else depth_m
        return (t - self.codec.shift) / self.codec.scale


def translated(generator: nn.Module, image: Tensor) -> Tensor:
    """A generator's output (B, 1, H, W), fp32, grown to its input's size if it is smaller."""
    return sized(generator(image).float(), image)


def sized(image: Tensor, like: Tensor) -> Tensor:
    """Grow an output at a lower stride to the size of an input."""
    if image.shape[2:] == like.shape[2:]:
        return image
    return F.interpolate(image, size=like.shape[2:], mode="bilinear", align_corners=False)


def present(part: _Part | None) -> _Part:
    """A network or an output that the weights of the losses call for.

    Raises:
        ValueError: there is none.
    """
    if part is None:
        raise ValueError("a weight above zero builds what its loss needs")
    return part


def not_none(*networks: nn.Module | None) -> list[nn.Module]:
    """Those of the networks that the weights of the losses call for."""
    return [network for network in networks if network is not None]


@contextmanager
def frozen(networks: Iterable[nn.Module]) -> Iterator[None]:
    """Let gradients pass through networks without gathering in them."""
    weights = [weight for network in networks for weight in network.parameters()]
    for weight in weights:
        weight.requires_grad_(False)
    try:
        yield
    finally:
        for weight in weights:
            weight.requires_grad_(True)
