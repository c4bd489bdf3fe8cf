"""Similarity loss of SimDCL between real and fake images of each domain."""

import torch.nn.functional as F  # noqa: N812
from torch import Tensor


def similarity(*, real_x: Tensor, fake_x: Tensor, real_y: Tensor, fake_y: Tensor) -> Tensor:
    """Mean |m(real x) − m(fake x)| + mean |m(real y) − m(fake y)| (Han et al. 2021, SimDCL).

    All are (B, D), one unit vector per image, of a ``SimilarityMap``. Returns a scalar, fp32; zero
    if real and fake vectors are equal.
    """
    x = F.l1_loss(fake_x.float(), real_x.float())
    return x + F.l1_loss(fake_y.float(), real_y.float())
