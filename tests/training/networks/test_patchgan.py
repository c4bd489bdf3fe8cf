"""The discriminator: size, output grid, what one output sees."""

from __future__ import annotations

import pytest
import torch

from depthcli.training.networks.patchgan import PatchGan


@pytest.mark.parametrize("antialias", [False, True])
def test_paper_size(antialias: bool) -> None:
    with torch.device("meta"):
        discriminator, image = PatchGan(antialias=antialias), torch.zeros(2, 1, 256, 256)
    assert discriminator(image).shape == (2, 1, 30, 30)
    assert sum(p.numel() for p in discriminator.parameters()) == 2_762_689


def test_one_output_sees_a_70_by_70_patch() -> None:
    torch.manual_seed(0)
    discriminator = PatchGan(width=2)
    for layer in discriminator.layers:  # a norm sees the whole image
        if isinstance(layer, torch.nn.InstanceNorm2d):
            layer.forward = lambda x: x  # type: ignore[method-assign]
    image = torch.rand(1, 1, 128, 128, requires_grad=True)
    output = discriminator(image)
    output[0, 0, output.shape[2] // 2, output.shape[3] // 2].backward()
    assert image.grad is not None
    rows, columns = image.grad[0, 0].nonzero().T
    assert int(rows.max() - rows.min()) + 1 == 70
    assert int(columns.max() - columns.min()) + 1 == 70


@pytest.mark.parametrize("antialias", [False, True])
def test_outputs_are_not_squashed(antialias: bool) -> None:
    discriminator = PatchGan(width=4, antialias=antialias)
    image = torch.rand(1, 1, 64, 64)
    with torch.no_grad():
        discriminator.layers[-1].bias.fill_(7)
        discriminator.layers[-1].weight.zero_()
        assert bool((discriminator(image) == 7).all())


def test_other_sizes() -> None:
    assert PatchGan(width=4)(torch.rand(1, 1, 64, 96)).shape == (1, 1, 6, 10)
