"""Opening the devices of a run, and launching its processes."""

import logging
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from lightning_fabric import Fabric
from lightning_fabric.utilities.exceptions import MisconfigurationException

from depthcli.core.exit_hooks import exit_hook
from depthcli.errors import TrainingError, UsageError
from depthcli.training.devices import AveragingStrategy, leave_process_group

Precision = Literal["32-true", "bf16-mixed", "16-mixed"]
_GRACE_PERIOD_S = 3.0


def open_fabric(accelerator: str, precision: Precision, devices: int = 1) -> Fabric:
    """Device, precision and processes of a run.

    Raises:
        UsageError: they are not available here.
    """
    logging.getLogger("lightning_fabric").setLevel(logging.ERROR)  # it would log under --quiet
    strategy = AveragingStrategy() if devices > 1 else "auto"
    try:
        return Fabric(
            accelerator=accelerator, devices=devices, strategy=strategy, precision=precision
        )
    except (ImportError, MisconfigurationException, RuntimeError, ValueError) as error:
        raise UsageError(
            f"cannot train on {devices} devices of {accelerator} with precision={precision} here: "
            f"{error}"
        ) from error


@contextmanager
def launched(fabric: Fabric) -> Iterator[None]:
    """Run the block in every process of a run, one per device; the others run this command again.

    Raises:
        TrainingError: another process ended early.
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
    except RuntimeError as error:
        if fabric.is_global_zero and _any_exited(started):
            raise TrainingError(
                "another process of this run ended early; the last checkpoint is kept"
            ) from error
        raise
    except Exception:
        if not fabric.is_global_zero:
            time.sleep(_GRACE_PERIOD_S)  # rank 0 reports the same error and kills this process
        raise
    else:
        leave_process_group()
        for process in started:
            process.wait()
    finally:
        _kill(started)


def _kill(processes: list[subprocess.Popen[bytes]]) -> None:
    for process in processes:
        process.kill()  # only rank 0 writes files


def _any_exited(processes: list[subprocess.Popen[bytes]]) -> bool:
    deadline = time.monotonic() + _GRACE_PERIOD_S
    while time.monotonic() < deadline:
        if any(process.poll() is not None for process in processes):
            return True
        time.sleep(0.1)
    return False
