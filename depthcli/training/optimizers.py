"""Optimizers of a method's phases."""

from typing import Any

import torch
from torch import nn

from depthcli.training.config.objective import OptimConfig
from depthcli.training.methods.base import Method, Phase


def build_optimizer(method: Method, phase: Phase, optim: OptimConfig) -> torch.optim.Optimizer:
    """AdamW over the networks of a phase, which is Adam where nothing decays."""
    networks, heads = method.networks(phase), method.heads() if optim.head_learning_rate else []
    body = [network for network in networks if network not in heads]
    groups = _parameter_groups(body, optim.weight_decay)
    for group in _parameter_groups(
        [network for network in networks if network in heads], optim.weight_decay
    ):
        betas = (optim.head_beta1, optim.head_beta2)
        groups.append(group | {"lr": optim.head_learning_rate, "betas": betas})
    return torch.optim.AdamW(groups, optim.learning_rate, (optim.beta1, optim.beta2))


def _parameter_groups(networks: list[nn.Module], weight_decay: float) -> list[dict[str, Any]]:
    """Kernels and matrices, which decay, and the rest, which does not."""
    weights = [w for network in networks for w in network.parameters()]
    groups: list[dict[str, Any]] = [
        {"params": [w for w in weights if w.ndim > 1], "weight_decay": weight_decay},
        {"params": [w for w in weights if w.ndim <= 1], "weight_decay": 0.0},
    ]
    return [group for group in groups if group["params"]]
