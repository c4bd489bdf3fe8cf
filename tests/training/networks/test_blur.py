"""Blurred changes of resolution against plain loops."""

import numpy as np
import pytest
import torch

from depthcli.training.networks.layers import BlurDown
from depthcli.training.networks.resnet import ResnetGenerator

GROW = ResnetGenerator(2, 1, antialias=True, residual="none").up1[0]


def _down(image: np.ndarray) -> np.ndarray:
    """[1, 2, 1]² / 16 at every second pixel of one (H, W) image with a reflected border."""
    padded, taps = np.pad(image, 1, mode="reflect"), (1, 2, 1)
    out = np.zeros(((image.shape[0] + 1) // 2, (image.shape[1] + 1) // 2))
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            for a in range(3):
                for b in range(3):
                    out[i, j] += taps[a] * taps[b] / 16 * padded[2 * i + a, 2 * j + b]
    return out


def _up(image: np.ndarray) -> np.ndarray:
    """Every pixel spreads [1, 3, 3, 1]² / 16 over the 4×4 finer pixels around its centre."""
    padded, taps = np.pad(image, 1, mode="edge"), (1, 3, 3, 1)
    fine = np.zeros((2 * padded.shape[0] + 2, 2 * padded.shape[1] + 2))
    for i in range(padded.shape[0]):
        for j in range(padded.shape[1]):
            for a in range(4):
                for b in range(4):
                    fine[2 * i + a, 2 * j + b] += taps[a] * taps[b] / 16 * padded[i, j]
    return fine[3:-3, 3:-3]


@pytest.mark.parametrize("size", [(6, 8), (5, 7)])
def test_down_is_its_formula(size: tuple[int, int]) -> None:
    image = torch.randn(1, 2, *size)
    found = BlurDown(2)(image)
    for channel in range(2):
        wanted = _down(image[0, channel].double().numpy())
        np.testing.assert_allclose(found[0, channel], wanted, atol=1e-6)


@pytest.mark.parametrize("size", [(3, 4), (5, 2)])
def test_up_is_its_formula(size: tuple[int, int]) -> None:
    image = torch.randn(1, 2, *size)
    found = GROW(image)
    assert found.shape == (1, 2, 2 * size[0], 2 * size[1])
    for channel in range(2):
        wanted = _up(image[0, channel].double().numpy())
        np.testing.assert_allclose(found[0, channel], wanted, atol=1e-6)


def test_kernels_are_neither_learned_nor_saved() -> None:
    for layer in (BlurDown(3), GROW):
        assert not list(layer.parameters())
        assert not layer.state_dict()
