"""Contrastive losses of the methods: patch vectors of an output against those of its input."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from depthcli.training.networks.build import Generator
from depthcli.training.networks.patch_sampler import PatchSampler


def patch_heads(generator: Generator, taps: Sequence[str]) -> PatchSampler:
    """Newly initialized heads for some taps of a generator."""
    return PatchSampler([generator.tap_channels(tap) for tap in taps])


def mean_over_taps(
    loss: Callable[[Tensor, Tensor], Tensor], queries: Sequence[Tensor], keys: Sequence[Tensor]
) -> Tensor:
    """Mean over the taps of a contrastive loss of patch vectors (B, P, dim); a scalar."""
    return torch.stack([loss(q, k) for q, k in zip(queries, keys, strict=True)]).mean()
