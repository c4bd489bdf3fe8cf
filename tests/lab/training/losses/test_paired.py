"""Losses of pairs, adversarial and contrastive."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import torch
from helpers.seeded import seeded
from torch import Tensor, nn

from depthcli.lab.training.losses import (
    cfl_nce,
    discriminator_loss,
    generator_loss,
    hdce,
    patch_nce,
    regularized_l1,
    semantic_relation,
)


def unit_vectors(seed: int, images: int = 2, patches: int = 7, dim: int = 5) -> Tensor:
    """(images, patches, dim) of length one, without gradient."""
    vectors = torch.randn(images, patches, dim, generator=seeded(seed))
    return vectors / vectors.norm(dim=2, keepdim=True)


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
    loss = regularized_l1(prediction, truth, network, penalty).item()
    assert loss == pytest.approx(distance + penalty * squares, rel=1e-5)


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
    hinge = 0.5 * (_mean([max(0, 1 - r) for r in real]) + _mean([max(0, 1 + f) for f in fake]))
    assert _loss(discriminator_loss, "hinge", outputs).item() == pytest.approx(hinge, rel=1e-5)
    hinge = _mean([max(0, 1 - f) for f in fake])
    assert _loss(generator_loss, "hinge", outputs).item() == pytest.approx(hinge, rel=1e-5)


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


@pytest.mark.parametrize("gamma", [50.0, 10.0, 0.2])
def test_hdce_is_its_formula(gamma: float) -> None:
    query, key = unit_vectors(1), unit_vectors(2)
    terms = []
    for q, k in zip(query.double().numpy(), key.double().numpy(), strict=True):
        for i, anchor in enumerate(q):
            others = np.delete(k, i, 0)
            weights = np.exp(others @ k[i] / gamma)
            weights /= weights.max()
            terms.append(np.log(np.exp((weights * (others @ anchor) - anchor @ k[i]) / TAU).sum()))
    assert hdce(query, key, gamma).item() == pytest.approx(np.mean(terms), rel=1e-5)


Loss = Callable[[Tensor, Tensor], Tensor]


@pytest.mark.parametrize(("loss", "fakes"), [(patch_nce, False), (cfl_nce, True)])
def test_patch_nce_is_its_formula(loss: Loss, fakes: bool) -> None:
    query, key = unit_vectors(1), unit_vectors(2)
    terms = []
    for q, k in zip(query.double().numpy(), key.double().numpy(), strict=True):
        for i, anchor in enumerate(q):
            keys = [k, np.delete(q, i, 0)] if fakes else [k]
            terms.append(
                -np.log(np.exp(anchor @ k[i] / TAU) / np.exp(np.vstack(keys) @ anchor / TAU).sum())
            )
    assert loss(query, key).item() == pytest.approx(np.mean(terms), rel=1e-5)


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
    (gradient,) = torch.autograd.grad(cfl_nce(query, key), query)
    still, itself = query.detach(), torch.eye(query.shape[1], dtype=torch.bool)
    to_truth = query @ key.transpose(1, 2) / TAU
    to_others = (query @ still.transpose(1, 2) / TAU).masked_fill(itself, -torch.inf)
    chances = torch.cat([to_truth, to_others], 2).log_softmax(2)
    loss = -chances.diagonal(dim1=1, dim2=2).mean()
    (expected,) = torch.autograd.grad(loss, query)
    torch.testing.assert_close(gradient, expected)


@pytest.mark.parametrize("loss", LOSSES)
def test_losses_stay_in_full_precision_under_autocast(loss: Loss) -> None:
    query, key = unit_vectors(7), unit_vectors(8)
    with torch.autocast("cpu", torch.bfloat16):
        mixed = loss(query, key)
    assert mixed.dtype == torch.float32
    assert mixed.item() == loss(query, key).item()


def test_relation_is_its_formula() -> None:
    query, key = unit_vectors(1), unit_vectors(2)
    images = []
    for vectors in zip(query.double().numpy(), key.double().numpy(), strict=True):
        raw = [np.exp(v @ v.T) for v in vectors]
        a, b = (values / values.sum(1, keepdims=True) for values in raw)
        middle = (a + b) / 2
        images.append((a * np.log(a / middle) + b * np.log(b / middle)).sum() / 2)
    assert semantic_relation(query, key).item() == pytest.approx(np.mean(images), rel=1e-4)
