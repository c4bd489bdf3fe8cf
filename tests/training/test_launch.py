"""The devices of a run, and what becomes of its other processes."""

import logging
import subprocess
import sys
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from depthcli.errors import TrainingError, UsageError
from depthcli.training.devices import AveragingStrategy, launched, open_fabric


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
