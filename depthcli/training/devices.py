"""Devices, processes and CPU threads of a run.

Training is data-parallel, one process per device: gradients are averaged explicitly, as
``DistributedDataParallel`` expects one forward and one backward pass of all weights per step. A
method has several of each, with some networks frozen in between, so the networks stay unwrapped
and :func:`average_gradients` runs between backward pass and optimizer step.
"""

import logging
import subprocess
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import torch
from lightning_fabric import Fabric
from lightning_fabric.strategies.ddp import DDPStrategy
from lightning_fabric.utilities.exceptions import MisconfigurationException
from torch import Tensor, distributed, nn

from depthcli.core.parallel import usable_cores
from depthcli.core.progress import exit_hook
from depthcli.errors import TrainingError, UsageError
from depthcli.training.checkpoint import saved_checkpoint

Precision = Literal["32-true", "bf16-mixed", "16-mixed"]
_GRACE_PERIOD_S = 3.0


class AveragingStrategy(DDPStrategy):
    """Processes and collectives of DDP, without its wrapper of the module."""

    def setup_module(self, module: nn.Module) -> nn.Module:  # type: ignore[override]
        """The module itself."""
        return module


def open_fabric(accelerator: str, precision: Precision, devices: int = 1) -> Fabric:
    """Device, precision and processes of a run."""
    logging.getLogger("lightning_fabric").setLevel(logging.ERROR)  # it would log under --quiet
    strategy = AveragingStrategy() if devices > 1 else "auto"
    try:
        return Fabric(
            accelerator=accelerator, devices=devices, strategy=strategy, precision=precision
        )
    except (ImportError, MisconfigurationException, RuntimeError, ValueError) as error:
        raise UsageError(
            f"cannot train on {devices} device{'s' * (devices > 1)} of {accelerator} with "
            f"precision={precision} here: {error}"
        ) from error


@contextmanager
def launched(fabric: Fabric) -> Iterator[None]:
    """Run the block in every process of a run, one per device; the others run this command again.

    Raises:
        TrainingError: a process failed.
    """
    if fabric.world_size == 1:
        yield
        return
    fabric.launch()
    others: list[subprocess.Popen[bytes]] = getattr(fabric.strategy.launcher, "procs", [])
    started, others[:] = list(others), []  # else Fabric would kill this process when one exits
    try:
        with exit_hook(lambda: _kill(started)):
            yield
    except Exception as error:
        if not fabric.is_global_zero:
            time.sleep(_GRACE_PERIOD_S)  # rank 0 reports the same error and kills this process
        if isinstance(error, RuntimeError):  # of the connection, when another process ended
            raise TrainingError(
                f"a process of this run failed: {error}", "the last checkpoint is kept"
            ) from error
        raise
    else:
        if distributed.is_initialized():  # before the interpreter's end destroys its threads
            distributed.destroy_process_group()
        for process in started:
            process.wait()
    finally:
        _kill(started)


def _kill(processes: list[subprocess.Popen[bytes]]) -> None:
    for process in processes:
        process.kill()  # only rank 0 writes files


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


def gather_states(fabric: Fabric, state: dict[str, Any]) -> list[dict[str, Any]]:
    """The states of the processes of rank 1 and up, in order; all processes must call this.

    A state is tensors, or containers of tensors, on the CPU.
    """
    if fabric.world_size == 1:
        return []
    states: list[Any] = [None] * fabric.world_size
    distributed.all_gather_object(states, state)
    return states[1:]


def set_threads(given: int | None, folder: Path, processes: int) -> None:
    """Set torch's CPU threads: the number given, else the checkpoint's, else one per free core.

    Args:
        given: number of threads of each process, or None.
        folder: of the run; another number would change the last digits of a resumed run.
        processes: number of processes that share the cores.
    """
    cores = usable_cores()
    saved = saved_checkpoint(folder) if given is None else None
    if saved is not None:
        given = min(cores, saved.state.threads)
    torch.set_num_threads(given or max(1, cores // processes))
