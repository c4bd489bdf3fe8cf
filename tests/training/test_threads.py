"""The number of threads of a run that names none."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from lightning_fabric import Fabric

from depthcli.core.parallel import usable_cores
from depthcli.training.checkpoint import CHECKPOINT
from depthcli.training.config import DataConfig, GeneratorConfig, TrainConfig
from depthcli.training.devices import set_threads
from depthcli.training.run import Run

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
