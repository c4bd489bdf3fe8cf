"""Semantic relation consistency against plain loops."""

import math

import numpy as np
import pytest
import torch
from helpers.vectors import unit_vectors
from torch import Tensor

from depthcli.training.losses import semantic_relation


def _relation(vectors: np.ndarray, i: int) -> list[float]:
    raw = [math.exp(vectors[i] @ other) for other in vectors]
    return [value / sum(raw) for value in raw]


def _looped(query: Tensor, key: Tensor) -> float:
    images = []
    for q, k in zip(query.double().numpy(), key.double().numpy(), strict=True):
        total = 0.0
        for i in range(len(q)):
            for a, b in zip(_relation(q, i), _relation(k, i), strict=True):
                middle = (a + b) / 2
                total += 0.5 * (a * math.log(a / middle) + b * math.log(b / middle))
        images.append(total)
    return float(np.mean(images))


def test_is_its_formula() -> None:
    query, key = unit_vectors(1), unit_vectors(2)
    assert semantic_relation(query, key).item() == pytest.approx(_looped(query, key), rel=1e-4)


def test_only_the_query_receives_a_gradient() -> None:
    query, key = unit_vectors(7).requires_grad_(), unit_vectors(8).requires_grad_()
    semantic_relation(query, key).backward()
    assert key.grad is None
    assert query.grad is not None
    assert bool(query.grad.abs().sum() > 0)


def test_relations_stay_in_full_precision_under_autocast() -> None:
    query, key = unit_vectors(9), unit_vectors(10)
    with torch.autocast("cpu", torch.bfloat16):
        mixed = semantic_relation(query, key)
    assert mixed.item() == semantic_relation(query, key).item()
