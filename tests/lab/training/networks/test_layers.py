"""Layers and the efficient network."""

import itertools

import numpy as np
import pytest
import torch

from depthcli.lab.training.config import GeneratorConfig
from depthcli.lab.training.networks.build import build_generator
from depthcli.lab.training.networks.efficient import EfficientGenerator
from depthcli.lab.training.networks.resnet import BlurDown, InstanceNorm, ResnetGenerator

GROW = ResnetGenerator(GeneratorConfig(width=2, blocks=1, antialias=True)).up1[0]


def _down(image: np.ndarray) -> np.ndarray:
    """[1, 2, 1]² / 16 at every second pixel of one (H, W) image with a reflected border."""
    parts = np.lib.stride_tricks.sliding_window_view(np.pad(image, 1, mode="reflect"), (3, 3))
    return (parts[::2, ::2] * np.outer((1, 2, 1), (1, 2, 1)) / 16).sum((2, 3))


def _up(image: np.ndarray) -> np.ndarray:
    """Every pixel spreads [1, 3, 3, 1]² / 16 over the 4×4 finer pixels around its centre."""
    padded, taps = np.pad(image, 1, mode="edge"), np.outer((1, 3, 3, 1), (1, 3, 3, 1)) / 16
    fine = np.zeros((2 * padded.shape[0] + 2, 2 * padded.shape[1] + 2))
    for y, x in np.ndindex(padded.shape):
        fine[2 * y : 2 * y + 4, 2 * x : 2 * x + 4] += taps * padded[y, x]
    return fine[3:-3, 3:-3]


@pytest.mark.parametrize("size", [(6, 8), (5, 7)])
def test_down_is_its_formula(size: tuple[int, int]) -> None:
    image = torch.randn(1, 2, *size)
    output = BlurDown(2)(image)
    for channel in range(2):
        expected = _down(image[0, channel].double().numpy())
        np.testing.assert_allclose(output[0, channel], expected, atol=1e-6)


@pytest.mark.parametrize("size", [(3, 4), (5, 2)])
def test_up_is_its_formula(size: tuple[int, int]) -> None:
    image = torch.randn(1, 2, *size)
    output = GROW(image)
    assert output.shape == (1, 2, 2 * size[0], 2 * size[1])
    for channel in range(2):
        expected = _up(image[0, channel].double().numpy())
        np.testing.assert_allclose(output[0, channel], expected, atol=1e-6)


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


def test_starts_in_the_middle_of_the_coding() -> None:
    assert not _small()(torch.rand(1, 1, 32, 32)).any()


def test_depths_and_dropout_are_those_of_the_configuration() -> None:
    config = GeneratorConfig(name="efficient", dropout=0.25, **SMALL)
    network = build_generator(config)
    assert isinstance(network, EfficientGenerator)
    assert [len(stage) for stage in network.stages] == [1, 2, 1, 1]
    assert network.dropout.p == 0.25
    network.load_state_dict(_small().state_dict())
