"""The number of usable CPU cores."""

import os


def usable_cores() -> int:
    """Cores that this process may run on, which in a container are fewer than the machine has."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def share_cores(workers: int | None = None, threads: int | None = None) -> tuple[int, int]:
    """Number of workers, and of threads for each of them.

    None stands for one worker a core, and for each worker's share of the cores.
    """
    cores = usable_cores()
    workers = workers or cores
    return workers, threads or max(1, cores // workers)
