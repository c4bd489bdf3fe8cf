"""ResNet generators and patch networks."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.lab.training.config import GeneratorConfig
from depthcli.lab.training.networks.patch import PatchGan, PatchSampler, SimilarityMap
from depthcli.lab.training.networks.resnet import BlurDown, InstanceNorm, ResnetGenerator

TAP_CHANNELS = {"input": 1, "down1": 128, "down2": 256, "block1": 256, "block5": 256}


def _small(**options: object) -> ResnetGenerator:
    torch.manual_seed(0)
    config = GeneratorConfig(**{"width": 8, "blocks": 2, "residual": "none"} | options)
    return ResnetGenerator(config).eval()


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
        network = ResnetGenerator(GeneratorConfig(antialias=antialias, residual=residual))
    assert _parameters(network) == 11_365_633 + more


def test_tap_channels_are_known_before_any_image() -> None:
    with torch.device("meta"):
        network, image = ResnetGenerator(GeneratorConfig()), torch.zeros(2, 1, 64, 32)
    maps = network.features(image)
    assert [network.tap_channels(tap) for tap in network.TAPS] == [m.shape[1] for m in maps]
    assert {tap: network.tap_channels(tap) for tap in network.TAPS} == TAP_CHANNELS
    sizes = [(70, 38), (32, 16), (16, 8), (16, 8), (16, 8)]
    assert [tuple(m.shape[2:]) for m in maps] == sizes


def test_taps_are_what_they_are_called() -> None:
    network = _small(width=4, blocks=6).train()
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
    network = _small(width=32, blocks=1, antialias=antialias)
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
    network, image = _grown(antialias=antialias, residual=residual), torch.rand(2, 1, 20, 16)
    with torch.no_grad():
        for name, weight in network.named_parameters():
            if weight.ndim < 2:
                weight.normal_(std=0.5 if name == "input_gain" else 0.05)
    wanted = _by_hand(network, image, antialias=antialias)
    torch.testing.assert_close(network(image), wanted, atol=1e-4, rtol=1e-4)


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
            layer.forward = lambda x: x
    image = torch.rand(1, 1, 128, 128, requires_grad=True)
    output = discriminator(image)
    output[0, 0, output.shape[2] // 2, output.shape[3] // 2].backward()
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


def _maps(*shapes: tuple[int, int, int]) -> list[Tensor]:
    return [torch.randn(2, *shape) for shape in shapes]


def test_vectors_have_length_one_at_256_positions_or_all() -> None:
    sampler = PatchSampler([3, 5])
    # Large features: the heads' first weights are small enough for ε to shorten the vectors.
    vectors, positions = sampler([100 * m for m in _maps((3, 20, 16), (5, 6, 7))])
    assert [tuple(v.shape) for v in vectors] == [(2, 256, 256), (2, 42, 256)]
    for v in vectors:
        torch.testing.assert_close(v.norm(dim=2), torch.ones(v.shape[:2]), atol=1e-3, rtol=0)
    for chosen, count in zip(positions, (320, 42), strict=True):
        assert len(set(chosen.tolist())) == len(chosen)
        assert 0 <= int(chosen.min()) <= int(chosen.max()) < count
    assert sorted(positions[1].tolist()) == list(range(42))


def test_positions_are_drawn_anew_and_can_be_given() -> None:
    sampler, maps = PatchSampler([3], dim=8, patches=16), _maps((3, 12, 12))
    vectors, positions = sampler(maps)
    again, same = sampler(maps, positions)
    torch.testing.assert_close(again, vectors)
    assert torch.equal(same[0], positions[0])
    assert not torch.equal(sampler(maps)[1][0], positions[0])


def test_vector_is_the_head_of_the_pixel_at_its_position() -> None:
    torch.manual_seed(0)
    sampler, (features,) = PatchSampler([3], dim=8), _maps((3, 5, 4))
    with torch.no_grad():
        for weight in sampler.parameters():
            weight.normal_()
    first, _, second = sampler.heads[0]
    (vectors,), _ = sampler([features], [torch.tensor([13, 2])])
    for p, (row, column) in enumerate(((3, 1), (0, 2))):
        hidden = first.weight @ features[1, :, row, column] + first.bias
        wanted = second.weight @ hidden.clamp(min=0) + second.bias
        torch.testing.assert_close(vectors[1, p], wanted / (wanted.norm() + 1e-7))


def test_vectors_of_a_blank_map_are_finite() -> None:
    sampler, blank = PatchSampler([2], dim=4), torch.zeros(1, 2, 4, 4, requires_grad=True)
    (vectors,), _ = sampler([blank])
    vectors.sum().backward()
    assert bool(torch.isfinite(vectors).all())
    assert blank.grad is not None
    assert bool(torch.isfinite(blank.grad).all())


def test_vectors_are_full_precision_under_autocast() -> None:
    sampler = PatchSampler([3], dim=8)
    with torch.autocast("cpu", torch.bfloat16):
        (vectors,), _ = sampler(_maps((3, 4, 4)))
    assert vectors.dtype == torch.float32


@pytest.mark.parametrize("narrow", [torch.bfloat16, torch.float16])
def test_similarity_map_is_full_precision_under_autocast(narrow: torch.dtype) -> None:
    torch.manual_seed(0)
    similarity_map, vectors = SimilarityMap(4), [torch.randn(2, 32, 16) / 16 for _ in range(4)]
    with torch.autocast("cpu", narrow):
        found = similarity_map(vectors)
    torch.testing.assert_close(found, similarity_map(vectors))
    torch.testing.assert_close(found.norm(dim=1), torch.ones(2))


def test_similarity_map_is_its_formula() -> None:
    torch.manual_seed(0)
    similarity_map = SimilarityMap(2, dim=3).double()
    taps = [torch.randn(1, 7, 6, dtype=torch.float64) for _ in range(2)]
    weights = {n: w.detach().numpy() for n, w in similarity_map.named_parameters()}
    pooled = np.zeros(3)
    corners = [(i, j) for i in (0, 2, 4) for j in (0, 2)]
    for channel in range(3):
        for i, j in corners:
            value = weights["conv.bias"][channel]
            for tap in range(2):
                for a in range(3):
                    for b in range(3):
                        kernel = weights["conv.weight"][channel, tap, a, b]
                        value += kernel * float(taps[tap][0, i + a, j + b])
            pooled[channel] += max(0.0, value) / len(corners)
    hidden = weights["linear.0.weight"] @ pooled + weights["linear.0.bias"]
    vector = weights["linear.2.weight"] @ np.maximum(hidden, 0) + weights["linear.2.bias"]
    wanted = vector / np.sqrt((vector**2).sum())
    np.testing.assert_allclose(similarity_map(taps)[0].detach().numpy(), wanted, rtol=1e-6)


def test_similarity_map_gives_each_image_its_own_vector() -> None:
    torch.manual_seed(0)
    similarity_map, vectors = SimilarityMap(4), [torch.randn(3, 32, 16) for _ in range(4)]
    found = similarity_map(vectors)
    assert found.shape == (3, 64)
    torch.testing.assert_close(found.norm(dim=1), torch.ones(3))
    for i in range(3):
        alone = similarity_map([v[i : i + 1] for v in vectors])
        torch.testing.assert_close(alone[0], found[i])
