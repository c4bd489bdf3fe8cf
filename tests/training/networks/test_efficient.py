"""The efficient generator: sizes, taps, and where its outputs begin."""

from __future__ import annotations

import pytest
import torch

from depthcli.training.config.schema import GeneratorConfig
from depthcli.training.networks.build import build_generator
from depthcli.training.networks.efficient import EfficientGenerator, ResidualBlock

SMALL = {"encoder": (4, 5, 6, 7, 8), "decoder": (9, 6, 5, 4), "depths": (1, 2, 1, 1)}


def _small() -> EfficientGenerator:
    torch.manual_seed(0)
    return EfficientGenerator(**SMALL).eval()


@pytest.mark.parametrize("size", [(64, 64), (48, 64), (33, 47), (31, 95), (1, 1)])
def test_output_is_half_the_size_of_any_picture(size: tuple[int, int]) -> None:
    output = _small()(torch.rand(2, 1, *size))
    assert output.shape == (2, 1, (size[0] + 1) // 2, (size[1] + 1) // 2)


def test_taps_are_known_before_any_picture() -> None:
    network = _small()
    maps = network.features(torch.rand(1, 1, 64, 32))
    assert [network.tap_channels(tap) for tap in network.TAPS] == [m.shape[1] for m in maps]
    sizes = [(32, 16), (16, 8), (8, 4), (4, 2)]
    assert [tuple(m.shape[2:]) for m in maps] == sizes
    (one,) = network.features(torch.rand(1, 1, 64, 32), ["stride8"])
    assert one.shape[1] == network.tap_channels("stride8") == 6


def test_starts_in_the_middle_of_the_coding() -> None:
    assert not _small()(torch.rand(1, 1, 32, 32)).any()


def test_every_weight_learns_once_the_head_has_moved() -> None:
    network = _small().train()
    torch.nn.init.normal_(network.head.weight)
    network(torch.randn(2, 1, 64, 64)).square().mean().backward()
    still = [n for n, p in network.named_parameters() if p.grad is None or not p.grad.any()]
    # A bias before the norm of the next layer's sum, of channels that ReLU closed, may stay.
    assert len(still) < 3, still


def test_sees_the_whole_picture() -> None:
    network = _small()
    torch.nn.init.normal_(network.head.weight)
    picture = torch.rand(1, 1, 128, 128, requires_grad=True)
    network(picture)[0, 0, 0, 0].backward()
    assert picture.grad is not None
    assert bool(picture.grad[0, 0, -8:, -8:].any())


def test_depths_and_dropout_are_those_of_the_configuration() -> None:
    config = GeneratorConfig(name="efficient", dropout=0.25, **SMALL)
    network = build_generator(config)
    assert isinstance(network, EfficientGenerator)
    assert [len(stage) for stage in network.stages] == [1, 2, 1, 1]
    assert network.dropout.p == 0.25
    network.load_state_dict(_small().state_dict())


@pytest.mark.parametrize(("outputs", "stride"), [(4, 1), (6, 1), (4, 2)])
def test_a_block_adds_to_its_input_and_takes_away_from_it(outputs: int, stride: int) -> None:
    torch.manual_seed(0)
    block = ResidualBlock(4, outputs, stride, norm=True).eval()
    x = torch.rand(2, 4, 8, 10)
    first, second = block.body
    hidden = torch.relu(first[1](torch.conv2d(x, first[0].weight, None, stride, 1)))
    change = second[1](torch.conv2d(hidden, second[0].weight, None, 1, 1)).detach()
    kept = x
    if outputs != 4 or stride != 1:
        kept = block.skip[1](torch.conv2d(x, block.skip[0].weight, None, stride))
    assert float(change.min()) < 0 < float(change.max())
    torch.testing.assert_close(block(x), torch.relu(kept + change))
