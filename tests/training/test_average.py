"""The moving average of weights."""

import pytest
import torch
from torch import nn

from depthcli.training.run import WeightAverage


def test_follows_the_decay_and_forgets_the_first_weights_soon() -> None:
    network = nn.Linear(1, 1, bias=False)
    nn.init.constant_(network.weight, 5)
    average, wanted = WeightAverage(network, 0.5), 5.0
    for step in range(1, 20):
        nn.init.constant_(network.weight, float(step))
        average.update(network, step)
        decay = min(0.5, step / (step + 9))
        wanted = decay * wanted + (1 - decay) * step
        assert average.network.weight.item() == pytest.approx(wanted, rel=1e-5)
    assert network.weight.item() == 19


def test_averages_statistics_and_copies_counts() -> None:
    network = nn.BatchNorm2d(2)
    average = WeightAverage(network, 0.0)
    network(torch.randn(4, 2, 8, 8) + 3)
    average.update(network, 1)
    torch.testing.assert_close(average.network.running_mean, network.running_mean)
    assert int(average.network.num_batches_tracked) == 1


def test_is_a_copy_to_evaluate() -> None:
    network = nn.Linear(2, 2)
    average = WeightAverage(network, 0.9)
    assert not average.network.training
    assert not any(p.requires_grad for p in average.network.parameters())
    with torch.no_grad():
        network.weight.add_(1)
    assert not torch.equal(average.network.weight, network.weight)
