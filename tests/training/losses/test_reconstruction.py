"""Reconstruction of hidden pixels against plain loops."""

import numpy as np
import pytest
import torch

from depthcli.training.losses import reconstruction_loss


@pytest.mark.parametrize("shrink", [1, 2])
def test_is_its_formula(shrink: int) -> None:
    random = torch.Generator().manual_seed(0)
    height, width = 6, 8
    output = torch.randn(2, 1, height, width, generator=random)
    size = (2, 1, shrink * height, shrink * width)
    picture, hidden = torch.randn(size, generator=random), torch.rand(size, generator=random) < 0.4
    total, weights = 0.0, 0.0
    for b in range(2):
        for i in range(height):
            for j in range(width):
                rows = slice(shrink * i, shrink * (i + 1))
                columns = slice(shrink * j, shrink * (j + 1))
                weight = np.mean(hidden[b, 0, rows, columns].numpy())
                target = np.mean(picture[b, 0, rows, columns].numpy())
                total += weight * abs(output[b, 0, i, j].item() - target)
                weights += weight
    found = reconstruction_loss(output, picture, hidden).item()
    assert found == pytest.approx(total / weights, rel=1e-5)


def test_what_is_seen_does_not_count() -> None:
    picture = torch.zeros(1, 1, 8, 8)
    hidden = torch.zeros_like(picture, dtype=torch.bool)
    assert reconstruction_loss(picture + 5, picture, hidden).item() == 0
    hidden[..., :4] = True
    output = picture.clone()
    output[..., 4:] = 7.0
    assert reconstruction_loss(output, picture, hidden).item() == 0
    assert reconstruction_loss(7 - output, picture, hidden).item() == 7
