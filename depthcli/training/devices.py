"""Data-parallel training, one process per device: gradients are averaged explicitly.

``DistributedDataParallel`` expects one forward and one backward pass of all weights per step. A
method has several of each, with some networks frozen in between, so the networks stay unwrapped
and :func:`average_gradients` runs between backward pass and optimizer step.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from lightning_fabric import Fabric
from lightning_fabric.strategies.ddp import DDPStrategy
from torch import Tensor, distributed, nn


class AveragingStrategy(DDPStrategy):
    """Processes and collectives of DDP, without its wrapper of the module."""

    def setup_module(self, module: nn.Module) -> nn.Module:  # type: ignore[override]
        """The module itself."""
        return module


def leave_process_group() -> None:
    """Leave the process group before interpreter shutdown destroys its threads."""
    if distributed.is_initialized():
        distributed.destroy_process_group()


@contextmanager
def rank_zero_first(fabric: Fabric) -> Iterator[None]:
    """Run the block in the process of rank 0, then, unless it raised, in the others."""
    if fabric.global_rank:
        fabric.barrier()
    yield
    if not fabric.global_rank:
        fabric.barrier()


def average_gradients(fabric: Fabric, weights: Iterable[Tensor]) -> None:
    """Replace the gradients by their mean over the processes, in one all-reduce.

    The same weights must have a gradient in every process.
    """
    if fabric.world_size == 1:
        return
    gradients = [weight.grad for weight in weights if weight.grad is not None]
    mean = fabric.all_reduce(torch.cat([g.reshape(-1) for g in gradients]), reduce_op="mean")
    parts = mean.split([g.numel() for g in gradients])  # type: ignore[union-attr]
    for gradient, part in zip(gradients, parts, strict=True):
        gradient.copy_(part.view(gradient.shape))


def any_process(fabric: Fabric, value: bool) -> bool:
    """Whether the value is true in any process; the same result in all of them."""
    if fabric.world_size == 1:
        return value
    count = fabric.all_reduce(torch.tensor(float(value), device=fabric.device), reduce_op="sum")
    return bool(count)


def gather_states(fabric: Fabric, state: dict[str, Any]) -> list[dict[str, Any]]:
    """The states of the processes of rank 1 and up, in order; all processes must call this.

    A state is tensors, or containers of tensors, on the CPU.
    """
    if fabric.world_size == 1:
        return []
    states: list[Any] = [None] * fabric.world_size
    distributed.all_gather_object(states, state)
    return states[1:]
