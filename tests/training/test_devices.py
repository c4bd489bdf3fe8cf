"""Devices, processes and threads of a run."""

import logging
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from helpers.rooms import EFFICIENT, room_data
from helpers.runs import same
from lightning_fabric import Fabric

from depthcli.core.parallel import usable_cores
from depthcli.errors import CheckpointError, TrainingError, UsageError
from depthcli.training.callbacks import Callback
from depthcli.training.checkpoint import CHECKPOINT, METRICS_LOG, Checkpoint
from depthcli.training.config import DataConfig, GeneratorConfig, TrainConfig
from depthcli.training.devices import (
    AveragingStrategy,
    average_gradients,
    gather_states,
    launched,
    open_fabric,
    set_threads,
)
from depthcli.training.run import Run, finite_losses, fit


def test_several_devices_average_and_one_does_not() -> None:
    logging.getLogger("lightning_fabric").setLevel(logging.INFO)
    one, two = open_fabric("cpu", "32-true"), open_fabric("cpu", "bf16-mixed", 2)
    assert (one.world_size, one.device.type) == (1, "cpu")
    assert not isinstance(one.strategy, AveragingStrategy)
    assert isinstance(two.strategy, AveragingStrategy)
    assert two.world_size == 2
    assert two.strategy.precision.precision == "bf16-mixed"
    assert not logging.getLogger("lightning_fabric").isEnabledFor(logging.WARNING)
    with launched(one):  # nothing is started
        pass
    with pytest.raises(UsageError):
        open_fabric("abacus", "32-true")


class _Others(SimpleNamespace):
    """Where Fabric would keep what it started: plain programs in the place of training ones."""

    def __init__(self, *programs: str, rank: int = 0) -> None:
        self.processes = [subprocess.Popen([sys.executable, "-Sc", code]) for code in programs]
        self.launch = bool
        launcher = SimpleNamespace(procs=list(self.processes))
        super().__init__(world_size=2, is_global_zero=not rank)
        self.strategy = SimpleNamespace(launcher=launcher)

    @property
    def codes(self) -> list[int]:
        return [process.wait() for process in self.processes]


@pytest.fixture
def others() -> Iterator[Any]:
    made: list[_Others] = []

    def make(*programs: str, rank: int = 0) -> _Others:
        made.append(_Others(*programs, rank=rank))
        return made[-1]

    yield make
    for each in made:
        for process in each.processes:
            process.kill()
            process.wait()


ENDLESS = "import time; time.sleep(60)"


def test_the_first_waits_for_the_others(others: Any) -> None:
    fabric = others("import time; time.sleep(0.3)")
    with launched(fabric):
        assert fabric.strategy.launcher.procs == []  # Fabric leaves them alone
    assert fabric.codes == [0]


def test_an_error_of_the_first_ends_the_others(others: Any) -> None:
    fabric = others(ENDLESS, ENDLESS)
    with pytest.raises(ZeroDivisionError), launched(fabric):
        raise ZeroDivisionError
    assert fabric.codes == [-9, -9]


def test_lost_connection_is_a_training_error(others: Any) -> None:
    fabric = others(ENDLESS, ENDLESS)
    with pytest.raises(TrainingError), launched(fabric):
        raise RuntimeError("connection closed")
    assert fabric.codes == [-9, -9]


CONFIG = replace(EFFICIENT, optim=replace(EFFICIENT.optim, batch_size=4))


def _each(fabric: Fabric, folder: Path) -> None:
    """What one of two processes does and keeps."""
    found = _exchange(fabric), _learn(fabric, folder)
    torch.save(found, folder / f"of-{fabric.global_rank}.pt")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What two processes left; spawned, for a fork would wait for locks of this one's threads."""
    folder = tmp_path_factory.mktemp("two")
    fabric = Fabric(accelerator="cpu", devices=2, strategy=AveragingStrategy(start_method="spawn"))
    fabric.launch(_each, folder)
    return folder


def _kept(folder: Path, which: int) -> list[Any]:
    """What both processes found."""
    return [torch.load(folder / f"of-{n}.pt", weights_only=False)[which] for n in (0, 1)]


def _exchange(fabric: Fabric) -> dict[str, Any]:
    rank = fabric.global_rank
    weights = [torch.nn.Parameter(torch.zeros(2, 3)), torch.nn.Parameter(torch.zeros(4))]
    weights[0].grad = torch.full((2, 3), 1.0 + 4 * rank)
    unused = torch.nn.Parameter(torch.zeros(1))
    average_gradients(fabric, [weights[0], unused])
    weights[1].grad = torch.arange(4.0) * (1 - 2 * rank)
    average_gradients(fabric, weights)
    return {
        "gradients": [weight.grad for weight in weights],
        "losses": finite_losses({"l1": torch.tensor(1.0 + rank)}, fabric),
        "others": gather_states(fabric, {"rank": rank}),
        "chance": (Run(CONFIG, fabric, 2).method.state_dict(), torch.rand(3)),
    }


def test_gradients_losses_and_states_are_exchanged(folder: Path) -> None:
    both = _kept(folder, 0)
    for found in both:
        assert same(found["gradients"], [torch.full((2, 3), 3.0), torch.zeros(4)])
        assert found["losses"] == {"l1": 1.5}
        assert found["others"] == [{"rank": 1}]
    (weights, _), (same_weights, of_second) = (found["chance"] for found in both)
    assert same(weights, same_weights)
    seeded = torch.Generator().manual_seed(CONFIG.seed + 1_000_003)  # as in every version
    assert torch.equal(of_second, torch.rand(3, generator=seeded))


def test_one_process_keeps_all_as_it_is() -> None:
    fabric, weight = Fabric(accelerator="cpu", devices=1), torch.nn.Parameter(torch.zeros(2))
    weight.grad = torch.ones(2)
    average_gradients(fabric, [weight])
    assert torch.equal(weight.grad, torch.ones(2))
    assert gather_states(fabric, {"rng": 1}) == []


def _learn(fabric: Fabric, folder: Path) -> list[tuple[int, dict[str, float]]]:
    notes = list[tuple[int, dict[str, float]]]()
    callback = Callback()
    callback.on_step_end = lambda state, _, losses: notes.append((state.step, losses))  # type: ignore[method-assign]
    for out, limits in (("whole", (2,)), ("parts", (1, 1))):
        for steps in limits:
            fit(CONFIG, room_data(), folder / out, fabric, callback, max_steps=steps)
    return notes


def test_two_processes_learn_as_one_and_go_on_exactly(folder: Path) -> None:
    """The same weights in both, chance of their own; the first one writes."""
    first, second = _kept(folder, 1)
    assert [step for step, _ in first] == [1, 2, 1, 2]
    assert first[:2] == first[2:]
    assert second == []  # the first one alone tells
    whole, parts = (Checkpoint.load(folder / out / CHECKPOINT) for out in ("whole", "parts"))
    for field in ("method", "ema_generator", "optimizers", "rng", "others"):
        assert same(getattr(whole, field), getattr(parts, field)), field
    assert len(whole.others) == 1
    assert not torch.equal(whole.rng, whole.others[0]["rng"])
    assert len((folder / "parts" / METRICS_LOG).read_text().splitlines()) == 2
    alone = Fabric(accelerator="cpu", devices=1)
    with pytest.raises(CheckpointError):
        fit(CONFIG, room_data(), folder / "whole", alone, Callback())


SMALL = TrainConfig(
    generator=GeneratorConfig(width=4, blocks=1), data=DataConfig(width=32, height=32)
)


@pytest.fixture(autouse=True)
def _restored() -> Iterator[None]:
    count = torch.get_num_threads()
    yield
    torch.set_num_threads(count)


def test_threads_are_given_or_saved_or_shared_cores(tmp_path: Path) -> None:
    cores = usable_cores()
    for given, processes, count in ((1, 1, 1), (None, 1, cores), (None, 2 * cores, 1)):
        set_threads(given, tmp_path, processes)
        assert torch.get_num_threads() == count
    run = Run(SMALL, Fabric(accelerator="cpu", devices=1), 1)
    for saved, count in ((1, 1), (10_000, cores), (0, cores)):  # 0: not recorded
        run.state = replace(run.state, threads=saved)
        run.save(tmp_path / CHECKPOINT)
        set_threads(None, tmp_path, 1)
        assert torch.get_num_threads() == count
