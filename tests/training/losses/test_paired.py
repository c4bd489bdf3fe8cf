"""Losses against the truth, in plain loops."""

import numpy as np
import pytest
import torch
from torch import nn

from depthcli.training.losses import SCALES, conv_weights, gradient_loss, regularized_l1


def _looped_gradient_loss(error: np.ndarray) -> float:
    """One (H, W) error: mean over scales of the mean steps along x and along y."""
    terms = []
    for _ in range(SCALES):
        height, width = error.shape
        along_x = [
            abs(error[i, j + 1] - error[i, j]) for i in range(height) for j in range(width - 1)
        ]
        along_y = [
            abs(error[i + 1, j] - error[i, j]) for i in range(height - 1) for j in range(width)
        ]
        terms.append(np.mean(along_x) + np.mean(along_y))
        smaller = np.zeros((height // 2, width // 2))
        for i in range(height // 2):
            for j in range(width // 2):
                smaller[i, j] = np.mean(error[2 * i : 2 * i + 2, 2 * j : 2 * j + 2])
        error = smaller
    return float(np.mean(terms))


@pytest.mark.parametrize("size", [(16, 16), (17, 22)])
def test_gradient_loss_is_its_formula(size: tuple[int, int]) -> None:
    generator = torch.Generator().manual_seed(0)
    prediction, truth = (torch.randn(1, 1, *size, generator=generator) for _ in range(2))
    wanted = _looped_gradient_loss((prediction - truth)[0, 0].double().numpy())
    assert gradient_loss(prediction, truth).item() == pytest.approx(wanted, rel=1e-5)


def _network() -> nn.Module:
    torch.manual_seed(0)
    return nn.Sequential(
        nn.Conv2d(1, 3, 3), nn.BatchNorm2d(3), nn.ConvTranspose2d(3, 2, 3), nn.Linear(2, 2)
    )


def test_regularized_l1_is_its_formula() -> None:
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
