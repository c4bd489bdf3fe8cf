"""Exponential moving average of a network's weights."""

import copy

import torch
from torch import nn


class WeightAverage:
    """Exponential moving average (EMA) of a network's weights.

    Each update keeps the fraction ``decay`` of the average, less in the first steps, so that the
    init weights have little influence. ``network`` has the average, in evaluation mode.
    """

    def __init__(self, network: nn.Module, decay: float) -> None:
        self.network = copy.deepcopy(network).eval().requires_grad_(False)
        self.decay = decay

    @torch.no_grad()
    def update(self, network: nn.Module, step: int) -> None:
        """Update the average with the weights after a step, counted from 1."""
        decay = min(self.decay, step / (step + 9))
        now = network.state_dict()
        for name, average in self.network.state_dict().items():
            if average.dtype.is_floating_point:
                average.lerp_(now[name].to(average.dtype), 1 - decay)
            else:
                average.copy_(now[name])
