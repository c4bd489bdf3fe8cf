"""Decoupled contrastive loss with hard negatives, weighted by the similarity of input patches."""

import torch
from torch import Tensor

from depthcli.training.losses.patchnce import TEMPERATURE
from depthcli.training.losses.precision import full_precision


def hdce(query: Tensor, key: Tensor, gamma: float) -> Tensor:
    """Mean over i of log Σ_{j≠i} exp((w_ij q_i·k_j − q_i·k_i)/τ) (Jung et al. 2022).

    Decoupled: the positive is not in the sum, so the loss has no lower bound at zero. At chance
    (q orthogonal to every key) it is ln(P − 1).

    Args:
        query: (B, P, C), unit vectors from the prediction; P at least 2.
        key: (B, P, C), unit vectors from the input, detached here.
        gamma: γ, temperature of the negatives' weights; see :func:`negative_weights`.

    Returns:
        A scalar, fp32.
    """
    with full_precision(query):
        query, key = query.float(), key.detach().float()
        products = torch.bmm(query, key.transpose(1, 2))
        own = products.diagonal(dim1=1, dim2=2).unsqueeze(2)
        logits = (negative_weights(key, gamma) * products - own) / TEMPERATURE
        return logits.masked_fill(_diagonal_mask(key), -torch.inf).logsumexp(2).mean()


def negative_weights(key: Tensor, gamma: float) -> Tensor:
    """w_ij: softmax over j ≠ i of k_i·k_j/γ, divided by its row's maximum, detached.

    Takes unit vectors (B, P, C), fp32; returns (B, P, P) in [0, 1] with a zero diagonal. A larger γ
    gives more uniform weights.
    """
    key = key.detach()
    relations = torch.bmm(key, key.transpose(1, 2)) / gamma
    weights = relations.masked_fill(_diagonal_mask(key), -torch.inf).softmax(2)
    return weights / weights.amax(2, keepdim=True)


def _diagonal_mask(key: Tensor) -> Tensor:
    return torch.eye(key.shape[1], dtype=torch.bool, device=key.device)
