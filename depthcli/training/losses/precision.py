"""Full precision within automatic mixed precision."""

import torch
from torch import Tensor


def full_precision(like: Tensor) -> torch.autocast:
    """A context that disables autocast on a tensor's device.

    Casting the arguments to float32 is not enough: autocast casts them back for each product.
    """
    return torch.autocast(like.device.type, enabled=False)
