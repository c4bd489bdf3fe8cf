"""The losses that compare a depth map with its ground truth, by the names of their weights."""

from collections.abc import Callable
from importlib import import_module
from typing import TypeAlias

from torch import Tensor

from depthcli.training.config.objective import PAIRED_LOSSES, LossConfig

PairedLoss: TypeAlias = Callable[[Tensor, Tensor, Tensor | None], Tensor]
"""Prediction and truth (B, 1, H, W), coded depth, and which pixels are known (B, 1, H, W) bool,
None for all; to a scalar."""


def paired_losses(weights: LossConfig) -> dict[str, PairedLoss]:
    """The losses with a weight above zero, by the weight's name."""
    return {name: _loss(place) for name, place in PAIRED_LOSSES.items() if getattr(weights, name)}


def _loss(place: str) -> PairedLoss:
    module, _, function = place.partition(":")
    found: PairedLoss = getattr(import_module(f"depthcli.training.losses.{module}"), function)
    return found
