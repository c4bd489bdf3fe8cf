"""Full precision inside mixed precision."""

import torch
from torch import Tensor


def full_precision(like: Tensor) -> torch.autocast:
    """A context on a tensor's device in which autocast halves nothing.

    Widening the arguments alone is not enough: autocast narrows them again for each product.
    """
    return torch.autocast(like.device.type, enabled=False)
