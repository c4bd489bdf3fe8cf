"""Patch-wise contrastive loss (eq. 4): InfoNCE over the patches of one image."""

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

from depthcli.training.losses.precision import full_precision

TEMPERATURE = 0.07
"""τ of eq. 4."""


def patch_nce(query: Tensor, key: Tensor) -> Tensor:
    """Cross-entropy of finding each query's own key among its image's keys (Park et al. 2020).

    Chance level is ln P.

    Args:
        query: (B, P, C), unit vectors from the prediction.
        key: (B, P, C), unit vectors from the input, detached here.

    Returns:
        Mean over all patches, a scalar, fp32.
    """
    with full_precision(query):
        logits = torch.bmm(query.float(), key.detach().float().transpose(1, 2)) / TEMPERATURE
        return _patch_cross_entropy(logits)


def cfl_nce(query: Tensor, key: Tensor) -> Tensor:
    """The paired form (Andonian et al. 2021): negatives from both prediction and ground truth.

    Chance level is ln(2P − 1). Arguments and result as of :func:`patch_nce`, with keys from the
    paired ground truth.
    """
    with full_precision(query):
        query, key = query.float(), key.detach().float()
        to_truth = torch.bmm(query, key.transpose(1, 2)) / TEMPERATURE
        to_prediction = torch.bmm(query, query.detach().transpose(1, 2)) / TEMPERATURE
        itself = torch.eye(query.shape[1], dtype=torch.bool, device=query.device)
        to_prediction = to_prediction.masked_fill(itself, -torch.inf)
        return _patch_cross_entropy(torch.cat([to_truth, to_prediction], 2))


def _patch_cross_entropy(logits: Tensor) -> Tensor:
    """Cross-entropy with patch i as the target of row i; logits (B, P, at least P)."""
    batch, patches, _ = logits.shape
    target = torch.arange(patches, device=logits.device).repeat(batch)
    return F.cross_entropy(logits.flatten(0, 1), target)
