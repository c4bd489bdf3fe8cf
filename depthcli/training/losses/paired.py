"""The losses that compare a depth map with its ground truth, by the names of their weights."""

from collections.abc import Callable
from pkgutil import resolve_name
from typing import TypeAlias

from torch import Tensor

from depthcli.training.config.objective import PAIRED_LOSSES, LossConfig

PairedLoss: TypeAlias = Callable[[Tensor, Tensor, Tensor | None], Tensor]
"""Prediction and truth (B, 1, H, W), coded depth, and which pixels are valid (B, 1, H, W) bool,
None for all; to a scalar."""


def paired_losses(weights: LossConfig) -> dict[str, PairedLoss]:
    """The losses with a weight above zero, by the weight's name."""
    return {
        name: resolve_name(f"depthcli.training.losses.{place}")
        for name, place in PAIRED_LOSSES.items()
        if getattr(weights, name)
    }
