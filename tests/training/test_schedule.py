"""Learning-rate factors, step by step."""

from __future__ import annotations

import math

import pytest

from depthcli.training.config import OptimConfig
from depthcli.training.schedule import cosine_factor, linear_factor, lr_factor


def test_linear_of_the_paper() -> None:
    for epoch in range(200):
        wanted = 1 - max(0, epoch + 1 - 100) / 101
        assert linear_factor(epoch, 100, 100) == pytest.approx(wanted)
    assert [linear_factor(e, 100, 100) for e in (0, 99)] == [1, 1]
    assert linear_factor(100, 100, 100) == pytest.approx(100 / 101)
    assert linear_factor(199, 100, 100) == pytest.approx(1 / 101)


def test_linear_is_constant_within_an_epoch() -> None:
    optim = OptimConfig(epochs_constant=1, epochs_decay=3)
    found = [lr_factor(optim, step, steps_per_epoch=2) for step in range(8)]
    assert found == pytest.approx([1, 1, 0.75, 0.75, 0.5, 0.5, 0.25, 0.25])


def test_cosine_with_warm_up() -> None:
    optim = OptimConfig(epochs_constant=0, epochs_decay=5, schedule="cosine", warmup_steps=4)
    for step in range(20):
        wanted = min(1, (step + 1) / 4) * (1 + math.cos(math.pi * step / 20)) / 2
        assert lr_factor(optim, step, steps_per_epoch=4) == pytest.approx(wanted)


def test_linear_with_warm_up() -> None:
    optim = OptimConfig(epochs_constant=1, epochs_decay=1, warmup_steps=4)
    found = [lr_factor(optim, step, steps_per_epoch=3) for step in range(6)]
    assert found == pytest.approx([1 / 4, 2 / 4, 3 / 4, 1 / 2, 1 / 2, 1 / 2])


def test_cosine_goes_from_one_to_zero() -> None:
    assert cosine_factor(0, 10) == 1
    assert cosine_factor(5, 10) == pytest.approx(0.5)
    assert cosine_factor(10, 10) == pytest.approx(0)
