"""The efficient generator: sizes, taps, and where its outputs begin."""

import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

from depthcli.training.config import GeneratorConfig
from depthcli.training.networks.build import build_generator
from depthcli.training.networks.efficient import EfficientGenerator

SMALL = {
    "encoder": (8, 16, 24, 32, 40),  # torch 2.13 corrupts memory where 8 divides a width not
    "decoder": (40, 24, 16, 8),
    "depths": (1, 2, 1, 1),
}


def _small(*, norm: bool = True) -> EfficientGenerator:
    torch.manual_seed(0)
    return EfficientGenerator(**SMALL, dropout=0.0, norm=norm).eval()


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
        picture = torch.rand(2, 1, *size, generator=random) * 2 - 1
        torch.testing.assert_close(network(picture), _by_hand(weights, picture))
    assert any(name.endswith("0.bias") for name in weights) is not norm
