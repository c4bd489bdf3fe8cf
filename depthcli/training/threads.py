"""Choosing the number of CPU threads of a run by a short trial, unless it is given.

torch's threads synchronize after every operation. On a machine with other load, two threads can be
four times slower than one.
"""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import torch
from lightning_fabric import Fabric
from torch import nn

from depthcli.core.parallel.cores import usable_cores
from depthcli.training.config.schema import TrainConfig
from depthcli.training.networks.build import build_generator
from depthcli.training.resolve import saved_checkpoint

_ROUNDS = 3
_TIME_LIMIT_S = 5.0
_MAX_TIME_RATIO = 0.95  # more threads must take at most this fraction of the time to be chosen


@dataclass(frozen=True, slots=True)
class Threads:
    """The CPU threads of a process."""

    count: int  #: how many it uses
    cores: int  #: how many it could use
    timed: bool  #: whether a short trial chose the number


def set_threads(asked: int | None, config: TrainConfig, folder: Path, fabric: Fabric) -> Threads:
    """Set torch's CPU threads: the number given, else the checkpoint's, else the fastest."""
    cores = usable_cores()
    saved = saved_checkpoint(folder) if asked is None else None
    if saved is not None:  # another number would change the last digits of the results
        asked = min(cores, saved.state.threads or torch.get_num_threads())
    count = default_threads(config, fabric, cores) if asked is None else asked
    torch.set_num_threads(count)
    return Threads(count, cores, asked is None)


def default_threads(config: TrainConfig, fabric: Fabric, cores: int) -> int:
    """The number of threads for a new run, at most ``cores``."""
    if fabric.world_size > 1:
        return max(1, cores // fabric.world_size)
    if fabric.device.type != "cpu" or cores == 1:
        return cores
    return fastest(_measured_s(config, fabric, candidates(cores)))


def candidates(cores: int) -> tuple[int, ...]:
    """The numbers of threads to try, in ascending order.

    >>> candidates(6)
    (1, 2, 4, 6)
    """
    doubled = [2**n for n in range(cores.bit_length()) if 2**n < cores]
    return (*doubled, cores)


def fastest(seconds: Mapping[int, float]) -> int:
    """The smallest number of threads that no larger one beats by more than 5 %.

    >>> fastest({1: 1.0, 2: 0.97}), fastest({1: 1.0, 2: 0.6}), fastest({1: 1.0, 2: 4.0})
    (1, 2, 1)
    """
    best = min(seconds)
    for threads in sorted(seconds):
        if seconds[threads] < _MAX_TIME_RATIO * seconds[best]:
            best = threads
    return best


def _measured_s(config: TrainConfig, fabric: Fabric, tried: tuple[int, ...]) -> dict[int, float]:
    """Seconds of a few steps of the generator for each number of threads, in turns."""
    data = config.data
    with _preserve_torch_state():
        network = build_generator(config.generator)
        pictures = torch.zeros(config.optim.batch_size, 1, data.height, data.width)
        spent_s = dict.fromkeys(tried, 0.0)
        began = time.perf_counter()
        _step_s(network, pictures, fabric)  # warm-up: the first one also allocates
        for _ in range(_ROUNDS):
            for threads in tried:
                torch.set_num_threads(threads)
                spent_s[threads] += _step_s(network, pictures, fabric)
            if time.perf_counter() - began > _TIME_LIMIT_S:
                break
    return spent_s


def _step_s(network: nn.Module, pictures: torch.Tensor, fabric: Fabric) -> float:
    began = time.perf_counter()
    with fabric.autocast():
        loss = network(pictures).square().mean()
    loss.backward()
    return time.perf_counter() - began


@contextmanager
def _preserve_torch_state() -> Iterator[None]:
    """Restore torch's random state and number of threads after the block."""
    threads = torch.get_num_threads()
    try:
        with torch.random.fork_rng(devices=[]):
            yield
    finally:
        torch.set_num_threads(threads)
