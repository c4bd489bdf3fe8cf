"""Layers and the efficient network."""

import itertools

import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

from depthcli.lab.training.config import GeneratorConfig
from depthcli.lab.training.networks.build import build_generator
from depthcli.lab.training.networks.efficient import EfficientGenerator
from depthcli.lab.training.networks.resnet import BlurDown, InstanceNorm, ResnetGenerator

GROW = ResnetGenerator(GeneratorConfig(width=2, blocks=1, antialias=True)).up1[0]


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


def test_neither_kernels_nor_statistics_are_learned_or_saved() -> None:
    for layer in (BlurDown(3), GROW, InstanceNorm(3)):
        layer(torch.randn(1, 3, 6, 5))
        assert not list(layer.parameters())
        assert not layer.state_dict()


LAYOUTS = (torch.contiguous_format, torch.channels_last)


@pytest.mark.parametrize("training", [True, False])
@pytest.mark.parametrize("images", [1, 2])
@pytest.mark.parametrize(("layout", "of_gradient"), [*itertools.product(LAYOUTS, LAYOUTS)])
def test_outputs_and_gradients_are_those_of_the_formula(
    images: int, training: bool, layout: torch.memory_format, of_gradient: torch.memory_format
) -> None:
    torch.manual_seed(0)
    values = 3 * torch.randn(images, 4, 6, 5) + 2
    weights = torch.randn(images, 4, 6, 5)

    exact = values.double().requires_grad_()
    centred = exact - exact.mean((2, 3), keepdim=True)
    truth = centred / (centred.square().mean((2, 3), keepdim=True) + 1e-5).sqrt()
    truth.backward(weights.double())

    x = values.to(memory_format=layout).requires_grad_()
    layer = InstanceNorm(4).train(training)
    output = layer(x)
    output.backward(weights.to(memory_format=of_gradient))
    torch.testing.assert_close(output.double(), truth)
    torch.testing.assert_close(layer.eval()(x.detach()), output)
    assert exact.grad is not None
    torch.testing.assert_close(x.grad.double(), exact.grad, rtol=1e-4, atol=1e-5)


SMALL = {
    "encoder": (8, 16, 24, 32, 40),  # torch 2.13 corrupts memory where 8 divides a width not
    "decoder": (40, 24, 16, 8),
    "depths": (1, 2, 1, 1),
}


def _small(*, norm: bool = True) -> EfficientGenerator:
    torch.manual_seed(0)
    return EfficientGenerator(GeneratorConfig(**SMALL, norm="batch" if norm else "none")).eval()


@pytest.mark.parametrize("size", [(64, 64), (48, 64), (33, 47), (31, 95), (1, 1)])
def test_output_is_half_the_size_of_any_image(size: tuple[int, int]) -> None:
    output = _small()(torch.rand(2, 1, *size))
    assert output.shape == (2, 1, (size[0] + 1) // 2, (size[1] + 1) // 2)


def test_taps_are_known_before_any_image() -> None:
    network = _small()
    maps = network.features(torch.rand(1, 1, 64, 32))
    assert [network.tap_channels(tap) for tap in network.TAPS] == [m.shape[1] for m in maps]
    sizes = [(32, 16), (16, 8), (8, 4), (4, 2)]
    assert [tuple(m.shape[2:]) for m in maps] == sizes
    (one,) = network.features(torch.rand(1, 1, 64, 32), ["stride8"])
    assert one.shape[1] == network.tap_channels("stride8") == 24


def test_starts_in_the_middle_of_the_coding() -> None:
    assert not _small()(torch.rand(1, 1, 32, 32)).any()


def test_every_weight_learns_once_the_head_has_moved() -> None:
    network = _small().train()
    torch.nn.init.normal_(network.head.weight)
    network(torch.randn(2, 1, 64, 64)).square().mean().backward()
    still = [n for n, p in network.named_parameters() if p.grad is None or not p.grad.any()]
    # A bias before the norm of the next layer's sum, of channels that ReLU closed, may stay.
    assert len(still) < 3, still


def test_depths_and_dropout_are_those_of_the_configuration() -> None:
    config = GeneratorConfig(name="efficient", dropout=0.25, **SMALL)
    network = build_generator(config)
    assert isinstance(network, EfficientGenerator)
    assert [len(stage) for stage in network.stages] == [1, 2, 1, 1]
    assert network.dropout.p == 0.25
    network.load_state_dict(_small().state_dict())


def _by_hand(weights: dict[str, Tensor], x: Tensor) -> Tensor:
    """The network written down once more, layer by layer."""

    def layer(name: str, x: Tensor, stride: int = 1) -> Tensor:
        kernel = weights[f"{name}.0.weight"]
        x = F.conv2d(x, kernel, weights.get(f"{name}.0.bias"), stride, kernel.shape[2] // 2)
        if f"{name}.1.weight" not in weights:
            return x
        mean, var, gain, bias = (
            weights[f"{name}.1.{part}"][:, None, None]
            for part in ("running_mean", "running_var", "weight", "bias")
        )
        return (x - mean) / (var + 1e-5).sqrt() * gain + bias

    maps = [layer("stem", x, 2).relu()]
    for stage, depth in enumerate(SMALL["depths"]):
        y = maps[-1]
        for block in range(depth):
            name, stride = f"stages.{stage}.{block}", 1 if block else 2
            hidden = layer(f"{name}.body.0", y, stride).relu()
            kept = y if block else layer(f"{name}.skip", y, stride)
            y = (layer(f"{name}.body.1", hidden) + kept).relu()
        maps.append(y)
    *skips, y = maps
    whole = y.mean((2, 3)) @ weights["whole_picture.weight"].T + weights["whole_picture.bias"]
    y = y + whole[:, :, None, None]
    for number, skip in enumerate(reversed(skips)):
        y = F.interpolate(y, skip.shape[2:], mode="bilinear", align_corners=False)
        y = layer(f"fusions.{number}", torch.cat([y, skip], 1)).relu()
    return F.conv2d(y, weights["head.weight"], weights["head.bias"], padding=1)


@pytest.mark.parametrize("norm", [True, False])
def test_is_its_layers(norm: bool) -> None:
    network, random = _small(norm=norm), torch.Generator().manual_seed(1)
    weights = network.state_dict()
    for name, values in weights.items():
        if values.is_floating_point():  # variances are above zero
            drawn = torch.randn(values.shape, generator=random)
            values.copy_(drawn.abs() + 0.5 if name.endswith("running_var") else 0.3 * drawn)
    for size in ((64, 32), (33, 47)):
        image = torch.rand(2, 1, *size, generator=random) * 2 - 1
        torch.testing.assert_close(network(image), _by_hand(weights, image))
    assert any(name.endswith("0.bias") for name in weights) is not norm
