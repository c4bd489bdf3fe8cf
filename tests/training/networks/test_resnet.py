"""The paper's generator: size, cost, taps and what its norm makes it blind to."""

import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn
from torch.utils.flop_counter import FlopCounterMode

from depthcli.training.networks.layers import BlurDown, InstanceNorm
from depthcli.training.networks.resnet import ResnetGenerator

TAP_CHANNELS = {"input": 1, "down1": 128, "down2": 256, "block1": 256, "block5": 256}


def _small(**options: object) -> ResnetGenerator:
    torch.manual_seed(0)
    return ResnetGenerator(8, 2, **{"residual": "none"} | options).eval()  # type: ignore[arg-type]


def _grown(**options: object) -> ResnetGenerator:
    """Weights as large as training makes them: beside the first ones the norm's ε counts."""
    network = _small(**options)
    for layer in network.modules():
        if isinstance(layer, (nn.Conv2d, nn.ConvTranspose2d)):
            nn.init.normal_(layer.weight, 0, 0.02 if layer is network.head[1] else 1)
    return network


def _parameters(network: nn.Module) -> int:
    return sum(p.numel() for p in network.parameters())


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.parametrize(("residual", "more"), [("none", 0), ("stem", 0), ("input", 1)])
def test_paper_size_has_the_papers_parameters(antialias: bool, residual: str, more: int) -> None:
    with torch.device("meta"):
        network = ResnetGenerator(antialias=antialias, residual=residual)  # type: ignore[arg-type]
    assert _parameters(network) == 11_365_633 + more


@pytest.mark.parametrize(("antialias", "gmac"), [(False, 48.7), (True, 63.3)])
def test_paper_size_costs_what_the_paper_size_costs(antialias: bool, gmac: float) -> None:
    with torch.device("meta"):
        network = ResnetGenerator(antialias=antialias, residual="none")
        image = torch.zeros(1, 1, 256, 256)
    with FlopCounterMode(display=False) as counter:
        network(image)
    assert counter.get_total_flops() / 2 / 1e9 == pytest.approx(gmac, abs=0.1)


def test_tap_channels_are_known_before_any_picture() -> None:
    with torch.device("meta"):
        network, image = ResnetGenerator(residual="none"), torch.zeros(2, 1, 64, 32)
    maps = network.features(image)
    assert [network.tap_channels(tap) for tap in network.TAPS] == [m.shape[1] for m in maps]
    assert {tap: network.tap_channels(tap) for tap in network.TAPS} == TAP_CHANNELS
    sizes = [(70, 38), (32, 16), (16, 8), (16, 8), (16, 8)]
    assert [tuple(m.shape[2:]) for m in maps] == sizes


def test_taps_are_what_they_are_called() -> None:
    torch.manual_seed(0)
    network = ResnetGenerator(4, 6, residual="none")
    image, seen = torch.randn(1, 1, 16, 16), {}
    modules = {"input": network.pad, "down1": network.down1.conv, "down2": network.down2.conv}
    modules |= {"block1": network.blocks[0], "block5": network.blocks[4]}
    for name, module in modules.items():
        # The first call counts: the padding is used once, the others once a pass.
        module.register_forward_hook(lambda _m, _i, o, name=name: seen.setdefault(name, o.clone()))
    network(image)
    for tap, found in zip(network.TAPS, network.features(image), strict=True):
        torch.testing.assert_close(found, seen[tap])


def test_taps_can_be_chosen_and_fall_back_to_the_last_block() -> None:
    network, image = _small(), torch.randn(1, 1, 16, 16)
    named = dict(zip(network.TAPS, network.features(image), strict=True))
    chosen = network.features(image, ("down1", "block5"))
    torch.testing.assert_close(chosen, [named["down1"], named["block5"]])
    last = network.blocks[1](named["block1"])
    torch.testing.assert_close(named["block5"], last)


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.parametrize("residual", ["none", "stem"])
def test_norm_hides_contrast_and_brightness(antialias: bool, residual: str) -> None:
    network, image = _grown(antialias=antialias, residual=residual), torch.rand(1, 1, 32, 32)
    plain, changed = network(image), network(0.5 * image + 0.2)
    assert float(plain.detach().std()) > 0.1
    torch.testing.assert_close(changed, plain, atol=2e-3, rtol=0)


def test_input_residual_sees_brightness_once_its_gain_is_learned() -> None:
    network, image = _grown(residual="input"), torch.rand(1, 1, 16, 16)
    torch.testing.assert_close(network(0.5 * image + 0.2), network(image), atol=2e-3, rtol=0)
    network(image).sum().backward()
    assert float(network.input_gain.grad.abs()) > 0
    with torch.no_grad():
        network.input_gain += 1
    assert float((network(0.5 * image + 0.2) - network(image)).detach().abs().max()) > 0.1


@pytest.mark.parametrize("antialias", [False, True])
def test_first_weights(antialias: bool) -> None:
    torch.manual_seed(0)
    network = ResnetGenerator(32, 1, antialias=antialias, residual="none")
    layers = [m for m in network.modules() if isinstance(m, (nn.Conv2d, nn.ConvTranspose2d))]
    assert len(layers) == 8
    for layer in layers:
        fans = layer.weight[0].numel() + layer.weight[:, 0].numel()
        spread = 0.02 * (2 / fans) ** 0.5 if antialias else 0.02
        assert layer.weight.std().item() == pytest.approx(spread, rel=0.1)
        assert not layer.bias.any()


@pytest.mark.parametrize("count", [1, 3])
def test_statistics_of_the_norm_stay_accurate_under_autocast(count: int) -> None:
    image = (100 + torch.randn(count, 2, 64, 64)).to(memory_format=torch.channels_last).bfloat16()
    exact = image.double()
    spread = exact.var((2, 3), keepdim=True, unbiased=False)
    exact = (exact - exact.mean((2, 3), keepdim=True)) / (spread + 1e-5).sqrt()
    with torch.autocast("cpu", torch.bfloat16):
        mixed = InstanceNorm(2)(image).double()
    torch.testing.assert_close(mixed, exact, atol=3e-2, rtol=2e-2)


def _by_hand(network: ResnetGenerator, x: Tensor, *, antialias: bool) -> Tensor:
    """The network written down once more, layer by layer."""

    def conv(layer: nn.Conv2d, x: Tensor, stride: int = 1, pad: int = 0) -> Tensor:
        return F.conv2d(x, layer.weight, layer.bias, stride, pad)

    def reflected(x: Tensor, pad: int) -> Tensor:
        return F.pad(x, (pad, pad, pad, pad), mode="reflect")

    y = stem = F.instance_norm(conv(network.stem[0], reflected(x, 3))).relu()
    for down in (network.down1, network.down2):
        y = F.instance_norm(conv(down.conv, y, 1 if antialias else 2, 1)).relu()
        y = BlurDown(y.shape[1])(y) if antialias else y
    for block in network.blocks:
        hidden = F.instance_norm(conv(block.body[1], reflected(y, 1))).relu()
        y = y + F.instance_norm(conv(block.body[4], reflected(hidden, 1)))
    for up in (network.up1, network.up2):
        if antialias:
            y = conv(up[1], up[0](y), 1, 1)
        else:
            y = F.conv_transpose2d(y, up[0].weight, up[0].bias, 2, 1, 1)
        y = F.instance_norm(y).relu()
    z = conv(network.head[1], reflected(y + stem if network.residual == "stem" else y, 3))
    return (z if network.input_gain is None else z + network.input_gain * x).tanh()


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.parametrize("residual", ["none", "stem", "input"])
def test_is_its_layers(antialias: bool, residual: str) -> None:
    network, picture = _grown(antialias=antialias, residual=residual), torch.rand(2, 1, 20, 16)
    with torch.no_grad():
        for name, weight in network.named_parameters():
            if weight.ndim < 2:
                weight.normal_(std=0.5 if name == "input_gain" else 0.05)
    wanted = _by_hand(network, picture, antialias=antialias)
    torch.testing.assert_close(network(picture), wanted, atol=1e-4, rtol=1e-4)
