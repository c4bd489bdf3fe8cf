"""The number of usable CPU cores."""

import math
import os
from pathlib import Path

_CPU_MAX = Path("/sys/fs/cgroup/cpu.max")


def usable_cores() -> int:
    """Cores that this process may use, which in a container can be fewer than the machine has."""
    cores = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    return max(1, math.ceil(min(cores, _quota(_CPU_MAX))))


def _quota(path: Path) -> float:
    """CPU seconds per second that a control group (version 2) may use; infinite without a limit."""
    try:
        quota_us, period_us = path.read_text("ascii").split()
        return int(quota_us) / int(period_us)
    except (OSError, ValueError, ZeroDivisionError):  # "max" stands for no limit
        return math.inf


def share_cores(workers: int | None = None, threads: int | None = None) -> tuple[int, int]:
    """Number of workers, and of threads for each of them.

    None stands for one worker a core, and for each worker's share of the cores.
    """
    cores = usable_cores()
    workers = workers or cores
    return workers, threads or max(1, cores // workers)
