"""Methods as they are set by default, on networks small enough for a test."""

from typing import Any

import torch
from torch import Tensor

from depthcli.lab.training.config import TrainConfig, updated
from depthcli.lab.training.data import TrainingBatch
from depthcli.lab.training.methods.registry import build_method, default_config

SIZES: dict[str, Any] = {
    "seed": 3,
    "generator": {"width": 8, "blocks": 2},
    "data": {"width": 32, "height": 32, "holdout_every": 4, "holdout_offset": 1},
    "optim": {"epochs_constant": 1, "epochs_decay": 1, "width_discriminator": 4},
}


def tiny(name: str, **loss: Any) -> TrainConfig:
    """A method in small, with some of its losses changed."""
    return updated(default_config(name), SIZES | {"loss": loss})


def tiny_method(name: str, **loss: Any) -> Any:
    """Its networks, the same each time."""
    torch.manual_seed(1)
    return build_method(tiny(name, **loss))


def phases(method: Any, seed: int = 5) -> dict[str, Tensor]:
    """Its terms of one batch, those of the discriminators first."""
    torch.manual_seed(seed)
    terms: dict[str, Tensor] = method(batch(), "discriminator")
    return terms | method(batch(), "generator")


def batch(seed: int = 0) -> TrainingBatch:
    """One image and one depth map of 32 x 32 pixels."""
    random = torch.Generator().manual_seed(seed)
    gray = torch.rand(1, 1, 32, 32, generator=random) * 2 - 1
    return TrainingBatch(gray, torch.rand(1, 1, 32, 32, generator=random) * 8 + 1)


def coded(depth_m: torch.Tensor) -> torch.Tensor:
    """Metres in [0, 10] to [-1, 1], as the papers' networks see depth."""
    return (depth_m - 5) / 5
