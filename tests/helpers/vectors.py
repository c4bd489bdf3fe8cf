"""Patch vectors for the contrastive losses."""

import torch
from torch import Tensor


def unit_vectors(seed: int, images: int = 2, patches: int = 7, dim: int = 5) -> Tensor:
    """(images, patches, dim) of length one, without gradient."""
    generator = torch.Generator().manual_seed(seed)
    vectors = torch.randn(images, patches, dim, generator=generator)
    return vectors / vectors.norm(dim=2, keepdim=True)
