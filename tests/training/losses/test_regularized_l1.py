"""Regularized L1 against plain loops."""

import numpy as np
import pytest
import torch
from torch import nn

from depthcli.training.losses import conv_weights, regularized_l1


def _network() -> nn.Module:
    torch.manual_seed(0)
    return nn.Sequential(
        nn.Conv2d(1, 3, 3), nn.BatchNorm2d(3), nn.ConvTranspose2d(3, 2, 3), nn.Linear(2, 2)
    )


def test_is_its_formula() -> None:
    network, penalty = _network(), 1e-2
    prediction, truth = torch.randn(2, 1, 4, 5), torch.randn(2, 1, 4, 5)
    pairs = zip(prediction.flatten().tolist(), truth.flatten().tolist(), strict=True)
    distance = float(np.mean([abs(p - t) for p, t in pairs]))
    squares = 0.0
    for index in (0, 2):  # biases, norms and linear layers are no convolution weights
        for w in network.get_submodule(str(index)).weight.flatten().tolist():  # type: ignore[operator,union-attr]
            squares += w * w
    found = regularized_l1(prediction, truth, network, penalty).item()
    assert found == pytest.approx(distance + penalty * squares, rel=1e-5)


def test_penalty_shrinks_the_weights_it_counts() -> None:
    network, image = _network(), torch.zeros(1, 1, 4, 4)
    regularized_l1(image, image, network, 1.0).backward()
    for weight in conv_weights(network):
        torch.testing.assert_close(weight.grad, 2 * weight.detach())
