"""The discriminator: size, output grid, what one output sees."""

import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.training.networks.layers import BlurDown
from depthcli.training.networks.patch import PatchGan


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


def _convolutions(discriminator: PatchGan) -> list[nn.Conv2d]:
    return [layer for layer in discriminator.layers if isinstance(layer, nn.Conv2d)]


def _written_down(discriminator: PatchGan, x: Tensor, *, antialias: bool) -> Tensor:
    """The network written down once more, layer by layer."""
    first, second, third, fourth, last = _convolutions(discriminator)
    stride = 1 if antialias else 2

    def smaller(y: Tensor) -> Tensor:
        return BlurDown(y.shape[1])(y) if antialias else y

    y = F.conv2d(x, first.weight, first.bias, stride, 1)
    y = smaller(torch.where(y > 0, y, 0.2 * y))
    for layer in (second, third):
        y = F.instance_norm(F.conv2d(y, layer.weight, layer.bias, stride, 1))
        y = smaller(torch.where(y > 0, y, 0.2 * y))
    y = F.instance_norm(F.conv2d(y, fourth.weight, fourth.bias, 1, 1))
    return F.conv2d(torch.where(y > 0, y, 0.2 * y), last.weight, last.bias, 1, 1)


@pytest.mark.parametrize("antialias", [False, True])
def test_is_its_layers_one_after_another(antialias: bool) -> None:
    torch.manual_seed(0)
    discriminator, image = PatchGan(width=4, antialias=antialias), torch.rand(2, 1, 48, 64)
    with torch.no_grad():
        for weight in discriminator.parameters():
            weight.normal_(std=0.3)
    wanted = _written_down(discriminator, image, antialias=antialias)
    torch.testing.assert_close(discriminator(image), wanted, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("antialias", [False, True])
def test_first_weights_are_normal_or_xavier(antialias: bool) -> None:
    torch.manual_seed(0)
    for layer in _convolutions(PatchGan(width=32, antialias=antialias))[1:4]:
        outputs, inputs = layer.weight.shape[:2]
        spread = 0.02 * ((2 / (16 * (inputs + outputs))) ** 0.5 if antialias else 1)
        assert layer.weight.std().item() == pytest.approx(spread, rel=0.05)
        assert layer.bias is not None
        assert not layer.bias.any()
