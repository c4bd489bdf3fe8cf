"""The devices that a run trains on, and the processes that it takes."""

from __future__ import annotations

import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal

from depthcli.cli.screen import console
from depthcli.errors import TrainingError, UsageError

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Iterator
    from pathlib import Path

    from lightning_fabric import Fabric

    from depthcli.training.config.schema import TrainConfig

Precision = Literal["32-true", "bf16-mixed", "16-mixed"]
_GRACE_S = 3.0


def open_fabric(accelerator: str, precision: Precision, devices: int = 1) -> Fabric:
    """Device, precision and processes of a run.

    Raises:
        UsageError: they are not to be had here.
    """
    import logging

    from lightning_fabric import Fabric
    from lightning_fabric.utilities.exceptions import MisconfigurationException

    from depthcli.training.devices import AveragingStrategy

    logging.getLogger("lightning_fabric").setLevel(logging.ERROR)  # it would speak under --quiet
    strategy = AveragingStrategy() if devices > 1 else "auto"
    try:
        return Fabric(
            accelerator=accelerator, devices=devices, strategy=strategy, precision=precision
        )
    except (ImportError, MisconfigurationException, RuntimeError, ValueError) as error:
        raise UsageError(
            f"cannot train with --accelerator {accelerator}, --devices {devices} and "
            f"precision={precision} here: {error}"
        ) from error


def set_threads(
    threads: int | None, config: TrainConfig, folder: Path, fabric: Fabric, *, quiet: bool
) -> None:
    """Use so many CPU threads; without a number those of the folder's run, or the fastest."""
    import torch

    from depthcli.core.parallel.cores import usable_cores
    from depthcli.training.continued import saved_run
    from depthcli.training.threads import default_threads

    cores = usable_cores()
    saved = saved_run(folder) if threads is None else None
    if saved is not None:  # another number would change its last digits
        threads = min(cores, saved.progress.threads or torch.get_num_threads())
    if threads is None:
        threads = default_threads(config, fabric, cores)
        if threads < cores and not quiet:
            console.note(
                f"training on {threads} of {cores} CPU cores, as fast as more of them in a short "
                "trial; --threads sets the number"
            )
    torch.set_num_threads(threads)


@contextmanager
def launched(fabric: Fabric) -> Iterator[None]:
    """Run the block in every process of a run: this same command again, once a device.

    Raises:
        TrainingError: another process ended early.
    """
    if fabric.world_size == 1:
        yield
        return
    from depthcli.training.devices import leave

    fabric.launch()
    others: list[subprocess.Popen[bytes]] = getattr(fabric.strategy.launcher, "procs", [])
    started, others[:] = list(others), []  # else Fabric would kill us as soon as one ends
    try:
        yield
    except RuntimeError as error:
        if fabric.is_global_zero and _one_ended(started):
            raise TrainingError(
                "another process of this run ended early; the last checkpoint is kept"
            ) from error
        raise
    except Exception:
        if not fabric.is_global_zero:
            time.sleep(_GRACE_S)  # the first process says the same, and ends this one
        raise
    else:
        leave()
        for process in started:
            process.wait()
    finally:
        for process in started:
            process.kill()  # it writes nothing


def _one_ended(processes: list[subprocess.Popen[bytes]]) -> bool:
    deadline = time.monotonic() + _GRACE_S
    while time.monotonic() < deadline:
        if any(process.poll() is not None for process in processes):
            return True
        time.sleep(0.1)
    return False
