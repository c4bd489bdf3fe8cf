"""Contrastive losses against plain loops, and who gets their gradients."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import torch
from helpers.vectors import unit_vectors
from torch import Tensor

from depthcli.training.losses import (
    cfl_nce,
    hdce,
    negative_weights,
    patch_nce,
    semantic_relation,
    similarity,
)

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
