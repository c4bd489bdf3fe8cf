"""Patch-wise contrast against plain loops, its chance levels and its gradients."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from helpers.vectors import unit_vectors
from torch import Tensor

from depthcli.training.losses import cfl_nce, patch_nce

Loss = Callable[[Tensor, Tensor], Tensor]
TAU = 0.07


def _looped(query: Tensor, key: Tensor, *, fakes: bool) -> float:
    terms = []
    for q, k in zip(query.double().numpy(), key.double().numpy(), strict=True):
        for i in range(len(q)):
            others = [j for j in range(len(q)) if j != i]
            logits = [q[i] @ k[i] / TAU] + [q[i] @ k[j] / TAU for j in others]
            logits += [q[i] @ q[j] / TAU for j in others if fakes]
            terms.append(-math.log(math.exp(logits[0]) / sum(math.exp(v) for v in logits)))
    return float(np.mean(terms))


@pytest.mark.parametrize(("loss", "fakes"), [(patch_nce, False), (cfl_nce, True)])
def test_is_its_formula(loss: Loss, fakes: bool) -> None:
    query, key = unit_vectors(1), unit_vectors(2)
    assert loss(query, key).item() == pytest.approx(_looped(query, key, fakes=fakes), rel=1e-5)


@pytest.mark.parametrize("loss", [patch_nce, cfl_nce])
def test_keys_receive_no_gradient(loss: Loss) -> None:
    query, key = unit_vectors(5).requires_grad_(), unit_vectors(6).requires_grad_()
    loss(query, key).backward()
    assert key.grad is None
    assert query.grad is not None
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


@pytest.mark.parametrize("loss", [patch_nce, cfl_nce])
def test_logits_stay_in_full_precision_under_autocast(loss: Loss) -> None:
    query, key = unit_vectors(7), unit_vectors(8)
    with torch.autocast("cpu", torch.bfloat16):
        mixed = loss(query, key)
    assert mixed.dtype == torch.float32
    assert mixed.item() == loss(query, key).item()
