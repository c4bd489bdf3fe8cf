"""Losses of pairs, adversarial and contrastive."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import torch
from helpers.vectors import unit_vectors
from torch import Tensor, nn

from depthcli.training.losses import (
    SCALES,
    cfl_nce,
    conv_weights,
    discriminator_loss,
    generator_loss,
    gradient_loss,
    hdce,
    negative_weights,
    patch_nce,
    regularized_l1,
    semantic_relation,
    similarity,
)


def _looped_gradient_loss(error: np.ndarray) -> float:
    """One (H, W) error: mean over scales of the mean steps along x and along y."""
    terms = []
    for _ in range(SCALES):
        height, width = error.shape
        along_x = [
            abs(error[i, j + 1] - error[i, j]) for i in range(height) for j in range(width - 1)
        ]
        along_y = [
            abs(error[i + 1, j] - error[i, j]) for i in range(height - 1) for j in range(width)
        ]
        terms.append(np.mean(along_x) + np.mean(along_y))
        smaller = np.zeros((height // 2, width // 2))
        for i in range(height // 2):
            for j in range(width // 2):
                smaller[i, j] = np.mean(error[2 * i : 2 * i + 2, 2 * j : 2 * j + 2])
        error = smaller
    return float(np.mean(terms))


@pytest.mark.parametrize("size", [(16, 16), (17, 22)])
def test_gradient_loss_is_its_formula(size: tuple[int, int]) -> None:
    generator = torch.Generator().manual_seed(0)
    prediction, truth = (torch.randn(1, 1, *size, generator=generator) for _ in range(2))
    wanted = _looped_gradient_loss((prediction - truth)[0, 0].double().numpy())
    assert gradient_loss(prediction, truth).item() == pytest.approx(wanted, rel=1e-5)


def _network() -> nn.Module:
    torch.manual_seed(0)
    return nn.Sequential(
        nn.Conv2d(1, 3, 3), nn.BatchNorm2d(3), nn.ConvTranspose2d(3, 2, 3), nn.Linear(2, 2)
    )


def test_regularized_l1_is_its_formula() -> None:
    network, penalty = _network(), 1e-2
    prediction, truth = torch.randn(2, 1, 4, 5), torch.randn(2, 1, 4, 5)
    pairs = zip(prediction.flatten().tolist(), truth.flatten().tolist(), strict=True)
    distance = float(np.mean([abs(p - t) for p, t in pairs]))
    squares = 0.0
    for index in (0, 2):  # biases, norms and linear layers are no convolution weights
        for w in network.get_submodule(str(index)).weight.flatten().tolist():
            squares += w * w
    found = regularized_l1(prediction, truth, network, penalty).item()
    assert found == pytest.approx(distance + penalty * squares, rel=1e-5)


def test_penalty_shrinks_the_weights_it_counts() -> None:
    network, image = _network(), torch.zeros(1, 1, 4, 4)
    regularized_l1(image, image, network, 1.0).backward()
    for weight in conv_weights(network):
        torch.testing.assert_close(weight.grad, 2 * weight.detach())


FORMS = ("lsgan", "hinge", "ralsgan")


@pytest.fixture
def outputs() -> tuple[Tensor, Tensor]:
    """Real and fake outputs of a discriminator, of different sizes so that none is mixed up."""
    generator = torch.Generator().manual_seed(1)
    real = torch.randn(2, 1, 5, 4, generator=generator)
    return real, 2 * torch.randn(2, 1, 3, 6, generator=generator) - 0.5


def _loss(loss: Callable[..., Tensor], gan: str, outputs: tuple[Tensor, Tensor]) -> Tensor:
    return loss(gan, nn.Identity(), real=outputs[0], fake=outputs[1])


def _mean(values: list[float]) -> float:
    return sum(values) / len(values)


def test_hinge_is_its_formula(outputs: tuple[Tensor, Tensor]) -> None:
    real, fake = (o.flatten().tolist() for o in outputs)
    wanted = 0.5 * (_mean([max(0, 1 - r) for r in real]) + _mean([max(0, 1 + f) for f in fake]))
    assert _loss(discriminator_loss, "hinge", outputs).item() == pytest.approx(wanted, rel=1e-5)
    wanted = _mean([max(0, 1 - f) for f in fake])
    assert _loss(generator_loss, "hinge", outputs).item() == pytest.approx(wanted, rel=1e-5)


def test_ralsgan_is_its_formula(outputs: tuple[Tensor, Tensor]) -> None:
    real, fake = (o.flatten().tolist() for o in outputs)
    mean_real, mean_fake = _mean(real), _mean(fake)

    def relative(to_fake: float, to_real: float) -> float:
        high = _mean([(r - mean_fake - to_fake) ** 2 for r in real])
        return 0.5 * (high + _mean([(f - mean_real - to_real) ** 2 for f in fake]))

    assert _loss(discriminator_loss, "ralsgan", outputs).item() == pytest.approx(
        relative(1, -1), rel=1e-5
    )
    assert _loss(generator_loss, "ralsgan", outputs).item() == pytest.approx(
        relative(-1, 1), rel=1e-5
    )


class _Judge(nn.Module):
    """Says of every patch the mean of its image, so that the verdict is known."""

    def __init__(self) -> None:
        super().__init__()
        self.gain = nn.Parameter(torch.ones(()))

    def forward(self, image: Tensor) -> Tensor:
        return self.gain * nn.functional.avg_pool2d(image, 4)


@pytest.mark.parametrize(
    ("gan", "real_value", "fake_value"), [("lsgan", 1, 0), ("hinge", 1, -1), ("ralsgan", 0.5, -0.5)]
)
def test_right_discriminator_loses_nothing(gan: str, real_value: float, fake_value: float) -> None:
    real = torch.full((1, 1, 8, 8), float(real_value))
    fake = torch.full((1, 1, 8, 8), float(fake_value))
    assert discriminator_loss(gan, _Judge(), real=real, fake=fake).item() == 0
    assert generator_loss(gan, _Judge(), real=real, fake=fake).item() > 0.9


@pytest.mark.parametrize("gan", FORMS)
def test_generator_moves_the_fake_towards_the_real(gan: str) -> None:
    real, fake = torch.ones(1, 1, 8, 8), torch.zeros(1, 1, 8, 8, requires_grad=True)
    generator_loss(gan, _Judge(), real=real, fake=fake).backward()
    assert fake.grad is not None
    assert bool((fake.grad < 0).all())


@pytest.mark.parametrize("gan", FORMS)
def test_outputs_are_judged_in_full_precision(gan: str) -> None:
    image = torch.linspace(-1, 1, 64).reshape(1, 1, 8, 8)
    with torch.autocast("cpu", torch.bfloat16):
        discriminator = nn.Conv2d(1, 1, 4)
        loss = generator_loss(gan, discriminator, real=image, fake=-image)
        assert discriminator(image).dtype == torch.bfloat16
    assert loss.dtype == torch.float32
    assert np.isfinite(loss.item())


TAU = 0.07
LOSSES = (patch_nce, cfl_nce, partial(hdce, gamma=10.0), semantic_relation)


def _weights(k: np.ndarray, i: int, gamma: float) -> dict[int, float]:
    raw = {j: math.exp(k[i] @ k[j] / gamma) for j in range(len(k)) if j != i}
    total = sum(raw.values())
    share = {j: value / total for j, value in raw.items()}
    return {j: value / max(share.values()) for j, value in share.items()}


def _looped_hdce(query: Tensor, key: Tensor, gamma: float) -> float:
    terms = []
    for q, k in zip(query.double().numpy(), key.double().numpy(), strict=True):
        for i in range(len(q)):
            own = q[i] @ k[i]
            weights = _weights(k, i, gamma)
            terms.append(
                math.log(sum(math.exp((w * (q[i] @ k[j]) - own) / TAU) for j, w in weights.items()))
            )
    return float(np.mean(terms))


@pytest.mark.parametrize("gamma", [50.0, 10.0, 0.2])
def test_hdce_is_its_formula(gamma: float) -> None:
    query, key = unit_vectors(1), unit_vectors(2)
    assert hdce(query, key, gamma).item() == pytest.approx(
        _looped_hdce(query, key, gamma), rel=1e-5
    )


def test_weights_favour_negatives_that_resemble_the_key() -> None:
    key = unit_vectors(3, images=1)
    weights, relations = negative_weights(key, 0.2)[0], (key @ key.transpose(1, 2))[0]
    for i in range(len(weights)):
        others = [j for j in range(len(weights)) if j != i]
        by_weight = sorted(others, key=lambda j, i=i: weights[i, j].item())
        assert by_weight == sorted(others, key=lambda j, i=i: relations[i, j].item())
        assert weights[i, by_weight[-1]] == 1
        assert weights[i, i] == 0


Loss = Callable[[Tensor, Tensor], Tensor]


def _looped_patch_nce(query: Tensor, key: Tensor, *, fakes: bool) -> float:
    terms = []
    for q, k in zip(query.double().numpy(), key.double().numpy(), strict=True):
        for i in range(len(q)):
            others = [j for j in range(len(q)) if j != i]
            logits = [q[i] @ k[i] / TAU] + [q[i] @ k[j] / TAU for j in others]
            logits += [q[i] @ q[j] / TAU for j in others if fakes]
            terms.append(-math.log(math.exp(logits[0]) / sum(math.exp(v) for v in logits)))
    return float(np.mean(terms))


@pytest.mark.parametrize(("loss", "fakes"), [(patch_nce, False), (cfl_nce, True)])
def test_patch_nce_is_its_formula(loss: Loss, fakes: bool) -> None:
    query, key = unit_vectors(1), unit_vectors(2)
    assert loss(query, key).item() == pytest.approx(
        _looped_patch_nce(query, key, fakes=fakes), rel=1e-5
    )


@pytest.mark.parametrize("loss", LOSSES)
def test_only_the_query_receives_a_gradient(loss: Loss) -> None:
    query, key = unit_vectors(5).requires_grad_(), unit_vectors(6).requires_grad_()
    loss(query, key).backward()
    assert key.grad is None
    assert bool(torch.isfinite(query.grad).all())
    assert bool(query.grad.abs().sum() > 0)


def test_other_patches_of_the_prediction_are_held_still_too() -> None:
    """The paired form moves a query away from the others, and not the others away from it."""
    query, key = unit_vectors(5).requires_grad_(), unit_vectors(6)
    (found,) = torch.autograd.grad(cfl_nce(query, key), query)
    still, itself = query.detach(), torch.eye(query.shape[1], dtype=torch.bool)
    to_truth = query @ key.transpose(1, 2) / TAU
    to_others = (query @ still.transpose(1, 2) / TAU).masked_fill(itself, -torch.inf)
    chances = torch.cat([to_truth, to_others], 2).log_softmax(2)
    loss = -chances.diagonal(dim1=1, dim2=2).mean()
    (wanted,) = torch.autograd.grad(loss, query)
    torch.testing.assert_close(found, wanted)


@pytest.mark.parametrize("loss", LOSSES)
def test_losses_stay_in_full_precision_under_autocast(loss: Loss) -> None:
    query, key = unit_vectors(7), unit_vectors(8)
    with torch.autocast("cpu", torch.bfloat16):
        mixed = loss(query, key)
    assert mixed.dtype == torch.float32
    assert mixed.item() == loss(query, key).item()


def _relation(vectors: np.ndarray, i: int) -> list[float]:
    raw = [math.exp(vectors[i] @ other) for other in vectors]
    return [value / sum(raw) for value in raw]


def _looped_relation(query: Tensor, key: Tensor) -> float:
    images = []
    for q, k in zip(query.double().numpy(), key.double().numpy(), strict=True):
        total = 0.0
        for i in range(len(q)):
            for a, b in zip(_relation(q, i), _relation(k, i), strict=True):
                middle = (a + b) / 2
                total += 0.5 * (a * math.log(a / middle) + b * math.log(b / middle))
        images.append(total)
    return float(np.mean(images))


def test_relation_is_its_formula() -> None:
    query, key = unit_vectors(1), unit_vectors(2)
    assert semantic_relation(query, key).item() == pytest.approx(
        _looped_relation(query, key), rel=1e-4
    )


def test_similarity_is_its_formula() -> None:
    real_x, fake_x, real_y, fake_y = (unit_vectors(i)[:, 0] for i in range(4))
    wanted = 0.0
    for real, fake in ((real_x, fake_x), (real_y, fake_y)):
        pairs = list(zip(real.flatten().tolist(), fake.flatten().tolist(), strict=True))
        wanted += sum(abs(r - f) for r, f in pairs) / len(pairs)
    found = similarity(real_x=real_x, fake_x=fake_x, real_y=real_y, fake_y=fake_y)
    assert found.item() == pytest.approx(wanted, rel=1e-5)
