"""The number of threads of a run that names none."""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from lightning_fabric import Fabric

from depthcli.core.parallel import usable_cores
from depthcli.training import devices as threads
from depthcli.training.checkpoint import CHECKPOINT
from depthcli.training.config import DataConfig, GeneratorConfig, OptimConfig, TrainConfig
from depthcli.training.devices import (
    AveragingStrategy,
    Threads,
    _measured_s,
    candidates,
    default_threads,
    fastest,
    set_threads,
)
from depthcli.training.run import Run

SMALL = TrainConfig(
    generator=GeneratorConfig(width=4, blocks=1),
    data=DataConfig(width=32, height=32),
    optim=OptimConfig(batch_size=2),
)


@pytest.mark.parametrize(
    ("cores", "tried"), [(1, (1,)), (2, (1, 2)), (3, (1, 2, 3)), (8, (1, 2, 4, 8))]
)
def test_what_is_tried(cores: int, tried: tuple[int, ...]) -> None:
    assert candidates(cores) == tried


@pytest.mark.parametrize(
    ("seconds", "chosen"),
    [
        ({1: 1.0, 2: 0.55, 4: 0.3}, 4),
        ({1: 1.0, 2: 0.55, 4: 0.54}, 2),  # no gain that others would not miss
        ({1: 1.0, 2: 4.4}, 1),  # a busy machine
        ({1: 1.0, 2: 4.4, 4: 0.5}, 4),
        ({1: 2.0}, 1),
    ],
)
def test_the_fastest_is_taken_and_fewer_where_it_is_as_fast(
    seconds: dict[int, float], chosen: int
) -> None:
    assert fastest(seconds) == chosen


def test_a_trial_leaves_no_trace_and_takes_no_longer_than_it_measures() -> None:
    fabric = Fabric(accelerator="cpu", devices=1)
    torch.manual_seed(4)
    before, count = torch.get_rng_state(), torch.get_num_threads()
    began = time.perf_counter()
    found = _measured_s(SMALL, fabric, (1, 2))
    assert sum(found.values()) < time.perf_counter() - began
    assert found.keys() == {1, 2}
    assert min(found.values()) > 0
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.get_num_threads() == count
    assert default_threads(SMALL, fabric, 1) == 1


@pytest.fixture
def _as_before() -> Iterator[None]:
    count = torch.get_num_threads()
    yield
    torch.set_num_threads(count)


@pytest.mark.usefixtures("_as_before")
def test_a_number_is_that_of_the_option_of_the_run_or_of_a_trial(tmp_path: Path) -> None:
    fabric, cores = Fabric(accelerator="cpu", devices=1), usable_cores()
    assert set_threads(1, SMALL, tmp_path, fabric) == Threads(1, cores, timed=False)
    found = set_threads(None, SMALL, tmp_path, fabric)
    assert found == Threads(torch.get_num_threads(), cores, timed=True)
    assert found.count in candidates(cores)
    run = Run(SMALL, fabric, 1)
    for saved, wanted in ((1, 1), (10_000, cores), (0, 1)):  # 0 is not known: as many as now
        run.state = replace(run.state, threads=saved)
        run.save(tmp_path / CHECKPOINT)
        torch.set_num_threads(1)
        assert set_threads(None, SMALL, tmp_path, fabric) == Threads(wanted, cores, timed=False)
        assert torch.get_num_threads() == wanted
    assert set_threads(1, SMALL, tmp_path, fabric).count == 1


@pytest.mark.parametrize(("seconds", "chosen"), [({1: 1.0, 2: 3.0}, 1), ({1: 3.0, 2: 1.0}, 2)])
def test_a_cpu_takes_what_its_trial_finds(
    seconds: dict[int, float], chosen: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(threads, "_measured_s", lambda *_: seconds)  # the only part of chance
    assert default_threads(SMALL, Fabric(accelerator="cpu", devices=1), 2) == chosen


def test_processes_share_the_cores() -> None:
    two = Fabric(accelerator="cpu", devices=2, strategy=AveragingStrategy())
    assert [default_threads(SMALL, two, cores) for cores in (1, 2, 5)] == [1, 1, 2]
