"""Similarity of domains: a fake looks, as a whole, like the real images of its domain."""

import torch.nn.functional as F  # noqa: N812
from torch import Tensor


def similarity(*, real_x: Tensor, fake_x: Tensor, real_y: Tensor, fake_y: Tensor) -> Tensor:
    """Mean |m(real x) − m(fake x)| + mean |m(real y) − m(fake y)| (Han et al. 2021, SimDCL).

    All are (B, D), one unit vector an image, of a ``SimilarityMap``; a scalar, fp32, which is zero
    where real and fake agree.
    """
    x = F.l1_loss(fake_x.float(), real_x.float())
    return x + F.l1_loss(fake_y.float(), real_y.float())
