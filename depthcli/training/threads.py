"""How many CPU threads a run takes when nobody says: the number that is fastest here and now.

torch's threads wait for each other after every operation. On a machine that has other work, one of
them is always late, and two threads can be four times slower than one.
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
from depthcli.training.resolve import saved_run

_ROUNDS = 3
_ENOUGH_S = 5.0
_WORTH_IT = 0.95  # more threads have to be that much faster, or they only cost the others


@dataclass(frozen=True, slots=True)
class Threads:
    """The CPU threads of a process."""

    count: int  #: how many it uses
    cores: int  #: how many it could use
    timed: bool  #: whether a short trial chose the number


def set_threads(asked: int | None, config: TrainConfig, folder: Path, fabric: Fabric) -> Threads:
    """Use so many CPU threads; without a number those of the folder's run, or the fastest."""
    cores = usable_cores()
    saved = saved_run(folder) if asked is None else None
    if saved is not None:  # another number would change its last digits
        asked = min(cores, saved.progress.threads or torch.get_num_threads())
    count = default_threads(config, fabric, cores) if asked is None else asked
    torch.set_num_threads(count)
    return Threads(count, cores, asked is None)


def default_threads(config: TrainConfig, fabric: Fabric, cores: int) -> int:
    """The number of threads for a new run, of the cores that this process may use."""
    if fabric.world_size > 1:
        return max(1, cores // fabric.world_size)
    if fabric.device.type != "cpu" or cores == 1:
        return cores
    return fastest(_measured_s(config, fabric, candidates(cores)))


def candidates(cores: int) -> tuple[int, ...]:
    """The numbers of threads to try, fewest first.

    >>> candidates(6)
    (1, 2, 4, 6)
    """
    doubled = [2**n for n in range(cores.bit_length()) if 2**n < cores]
    return (*doubled, cores)


def fastest(seconds: Mapping[int, float]) -> int:
    """The fewest threads that no larger number beats by more than a few per cent.

    >>> fastest({1: 1.0, 2: 0.97}), fastest({1: 1.0, 2: 0.6}), fastest({1: 1.0, 2: 4.0})
    (1, 2, 1)
    """
    best = min(seconds)
    for threads in sorted(seconds):
        if seconds[threads] < _WORTH_IT * seconds[best]:
            best = threads
    return best


def _measured_s(config: TrainConfig, fabric: Fabric, tried: tuple[int, ...]) -> dict[int, float]:
    """Seconds of some steps of the generator with each number of threads, in turns."""
    data = config.data
    with _as_it_was():
        network = build_generator(config.generator)
        pictures = torch.zeros(config.optim.batch_size, 1, data.height, data.width)
        spent_s = dict.fromkeys(tried, 0.0)
        began = time.perf_counter()
        _step_s(network, pictures, fabric)  # the first one also allocates and plans
        for _ in range(_ROUNDS):
            for threads in tried:
                torch.set_num_threads(threads)
                spent_s[threads] += _step_s(network, pictures, fabric)
            if time.perf_counter() - began > _ENOUGH_S:
                break
    return spent_s


def _step_s(network: nn.Module, pictures: torch.Tensor, fabric: Fabric) -> float:
    began = time.perf_counter()
    with fabric.autocast():
        loss = network(pictures).square().mean()
    loss.backward()
    return time.perf_counter() - began


@contextmanager
def _as_it_was() -> Iterator[None]:
    """Leave no trace in torch's random numbers and number of threads."""
    threads = torch.get_num_threads()
    try:
        with torch.random.fork_rng(devices=[]):
            yield
    finally:
        torch.set_num_threads(threads)
