"""The PatchGAN discriminator, patch heads and similarity maps."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.training.networks.layers import BlurDown
from depthcli.training.networks.patch import PatchGan, PatchSampler, SimilarityMap


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
        assert not layer.bias.any()


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


def test_first_weights_of_the_heads() -> None:
    torch.manual_seed(0)
    layers = [m for m in PatchSampler([128]).modules() if isinstance(m, nn.Linear)]
    assert len(layers) == 2
    for layer in layers:
        spread = 0.02 * (2 / sum(layer.weight.shape)) ** 0.5
        assert layer.weight.std().item() == pytest.approx(spread, rel=0.05)
        assert not layer.bias.any()


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


def test_similarity_map_has_the_parameters_stated() -> None:
    assert sum(p.numel() for p in SimilarityMap(4).parameters()) == 10_688


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


def test_similarity_map_takes_maps_of_different_sizes() -> None:
    torch.manual_seed(0)
    similarity_map = SimilarityMap(2)
    many, few = torch.randn(1, 40, 16), torch.randn(1, 12, 16)
    torch.testing.assert_close(similarity_map([many, few]), similarity_map([many[:, :12], few]))
