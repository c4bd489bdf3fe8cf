"""The number of threads of a run that names none."""

from __future__ import annotations

import pytest
import torch
from lightning_fabric import Fabric

from depthcli.training.config.schema import DataConfig, GeneratorConfig, OptimConfig, TrainConfig
from depthcli.training.threads import candidates, default_threads, fastest

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


def test_a_trial_leaves_no_trace() -> None:
    fabric = Fabric(accelerator="cpu", devices=1)
    torch.manual_seed(4)
    before, threads = torch.get_rng_state(), torch.get_num_threads()
    assert default_threads(SMALL, fabric, 2) in {1, 2}
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.get_num_threads() == threads
    assert default_threads(SMALL, fabric, 1) == 1
