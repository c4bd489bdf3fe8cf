"""ResNet generators and patch networks."""

import pytest
import torch
from torch import Tensor, nn

from depthcli.lab.training.config import GeneratorConfig
from depthcli.lab.training.networks.patch import PatchGan, PatchSampler, SimilarityMap
from depthcli.lab.training.networks.resnet import InstanceNorm, ResnetGenerator


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


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.parametrize(("residual", "more"), [("none", 0), ("stem", 0), ("input", 1)])
def test_paper_size_has_the_papers_parameters(antialias: bool, residual: str, more: int) -> None:
    with torch.device("meta"):
        network = ResnetGenerator(GeneratorConfig(antialias=antialias, residual=residual))
    assert sum(p.numel() for p in network.parameters()) == 11_365_633 + more


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


@pytest.mark.parametrize("count", [1, 3])
def test_statistics_of_the_norm_stay_accurate_under_autocast(count: int) -> None:
    image = (100 + torch.randn(count, 2, 64, 64)).to(memory_format=torch.channels_last).bfloat16()
    exact = image.double()
    spread = exact.var((2, 3), keepdim=True, unbiased=False)
    exact = (exact - exact.mean((2, 3), keepdim=True)) / (spread + 1e-5).sqrt()
    with torch.autocast("cpu", torch.bfloat16):
        mixed = InstanceNorm(2)(image).double()
    torch.testing.assert_close(mixed, exact, atol=3e-2, rtol=2e-2)


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
        embedding = similarity_map(vectors)
    torch.testing.assert_close(embedding, similarity_map(vectors))
    torch.testing.assert_close(embedding.norm(dim=1), torch.ones(2))


def test_similarity_map_gives_each_image_its_own_vector() -> None:
    torch.manual_seed(0)
    similarity_map, vectors = SimilarityMap(4), [torch.randn(3, 32, 16) for _ in range(4)]
    embedding = similarity_map(vectors)
    assert embedding.shape == (3, 64)
    torch.testing.assert_close(embedding.norm(dim=1), torch.ones(3))
    for i in range(3):
        alone = similarity_map([v[i : i + 1] for v in vectors])
        torch.testing.assert_close(alone[0], embedding[i])
