"""Multi-scale gradient matching against plain loops."""

import numpy as np
import pytest
import torch

from depthcli.training.losses import SCALES, gradient_loss


def _looped(error: np.ndarray) -> float:
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
def test_is_its_formula(size: tuple[int, int]) -> None:
    generator = torch.Generator().manual_seed(0)
    prediction, truth = (torch.randn(1, 1, *size, generator=generator) for _ in range(2))
    wanted = _looped((prediction - truth)[0, 0].double().numpy())
    assert gradient_loss(prediction, truth).item() == pytest.approx(wanted, rel=1e-5)
