"""Semantic relation consistency (SRC) between the patches of input and output."""

import math

import torch
from torch import Tensor

from depthcli.training.losses.precision import full_precision


def semantic_relation(query: Tensor, key: Tensor) -> Tensor:
    """Σ_i JSD(softmax(QQᵀ)_i ‖ softmax(KKᵀ)_i), mean over images (Jung et al. 2022).

    A scalar, fp32: zero if and only if all relations agree, at most P ln 2. Queries of the
    prediction and keys of the input, which are detached here, are unit vectors (B, P, C).
    """
    with full_precision(query):
        ours, theirs = _log_relations(query.float()), _log_relations(key.detach().float())
        middle = torch.logaddexp(ours, theirs) - math.log(2)
        divergence = ours.exp() * (ours - middle) + theirs.exp() * (theirs - middle)
        return 0.5 * divergence.sum((1, 2)).mean()


def _log_relations(vectors: Tensor) -> Tensor:
    """Log of each patch's softmax over all patches; (B, P, C) to (B, P, P)."""
    return torch.bmm(vectors, vectors.transpose(1, 2)).log_softmax(2)
