"""Hard-negative decoupled contrast against plain loops."""

import math

import numpy as np
import pytest
import torch
from helpers.vectors import unit_vectors
from torch import Tensor

from depthcli.training.losses import hdce, negative_weights

TAU = 0.07


def _weights(k: np.ndarray, i: int, gamma: float) -> dict[int, float]:
    raw = {j: math.exp(k[i] @ k[j] / gamma) for j in range(len(k)) if j != i}
    total = sum(raw.values())
    share = {j: value / total for j, value in raw.items()}
    return {j: value / max(share.values()) for j, value in share.items()}


def _looped(query: Tensor, key: Tensor, gamma: float) -> float:
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
def test_is_its_formula(gamma: float) -> None:
    query, key = unit_vectors(1), unit_vectors(2)
    assert hdce(query, key, gamma).item() == pytest.approx(_looped(query, key, gamma), rel=1e-5)


def test_weights_favour_negatives_that_resemble_the_key() -> None:
    key = unit_vectors(3, images=1)
    weights, relations = negative_weights(key, 0.2)[0], (key @ key.transpose(1, 2))[0]
    for i in range(len(weights)):
        others = [j for j in range(len(weights)) if j != i]
        by_weight = sorted(others, key=lambda j, i=i: weights[i, j].item())
        assert by_weight == sorted(others, key=lambda j, i=i: relations[i, j].item())
        assert weights[i, by_weight[-1]] == 1
        assert weights[i, i] == 0


def test_only_the_query_receives_a_gradient() -> None:
    query, key = unit_vectors(5).requires_grad_(), unit_vectors(6).requires_grad_()
    hdce(query, key, 10.0).backward()
    assert key.grad is None
    assert query.grad is not None
    assert bool(torch.isfinite(query.grad).all())
    assert bool(query.grad.abs().sum() > 0)


def test_logits_stay_in_full_precision_under_autocast() -> None:
    query, key = unit_vectors(7), unit_vectors(8)
    with torch.autocast("cpu", torch.bfloat16):
        mixed = hdce(query, key, 10.0)
    assert mixed.item() == hdce(query, key, 10.0).item()
