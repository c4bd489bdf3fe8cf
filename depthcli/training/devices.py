"""Training with several processes, one a device: gradients are averaged by hand.

``DistributedDataParallel`` expects one forward and one backward pass of all weights a step. A
method has several of each, over parts of its networks that are frozen in between, so the
networks stay unwrapped and :func:`average_gradients` runs between backward pass and step.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from lightning_fabric import Fabric
from lightning_fabric.strategies.ddp import DDPStrategy
from torch import Tensor, distributed, nn


class AveragingStrategy(DDPStrategy):
    """Processes and collectives of DDP, without its wrapper around the networks."""

    def setup_module(self, module: nn.Module) -> nn.Module:  # type: ignore[override]
        """The module as it is."""
        return module


def leave() -> None:
    """Leave the group of processes, whose threads would be torn down with the interpreter."""
    if distributed.is_initialized():
        distributed.destroy_process_group()


@contextmanager
def first_process_first(fabric: Fabric) -> Iterator[None]:
    """Let the others begin the block when the first process is through, without an error."""
    if fabric.global_rank:
        fabric.barrier()
    yield
    if not fabric.global_rank:
        fabric.barrier()


def average_gradients(fabric: Fabric, weights: Iterable[Tensor]) -> None:
    """Replace the gradients of every process by their mean, in one collective.

    The weights that have a gradient must be the same in every process.
    """
    if fabric.world_size == 1:
        return
    gradients = [weight.grad for weight in weights if weight.grad is not None]
    mean = fabric.all_reduce(torch.cat([g.reshape(-1) for g in gradients]), reduce_op="mean")
    parts = mean.split([g.numel() for g in gradients])  # type: ignore[union-attr]
    for gradient, part in zip(gradients, parts, strict=True):
        gradient.copy_(part.view(gradient.shape))


def any_process(fabric: Fabric, said: bool) -> bool:
    """Whether any process says so; each of them gets the same answer."""
    if fabric.world_size == 1:
        return said
    votes = fabric.all_reduce(torch.tensor(float(said), device=fabric.device), reduce_op="sum")
    return bool(votes)


def of_others(fabric: Fabric, state: dict[str, Any]) -> list[dict[str, Any]]:
    """What the processes after the first hand over, by rank; called by all of them.

    The state is tensors and containers of them, on the CPU.
    """
    if fabric.world_size == 1:
        return []
    states: list[Any] = [None] * fabric.world_size
    distributed.all_gather_object(states, state)
    return states[1:]
