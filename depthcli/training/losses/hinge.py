"""Hinge GAN, with the generator's margin of the DCLGAN family."""

import torch.nn.functional as F  # noqa: N812
from torch import Tensor


def hinge_discriminator(real: Tensor, fake: Tensor) -> Tensor:
    """½(mean max(0, 1 − D(real)) + mean max(0, 1 + D(fake))) of outputs (B, 1, h, w)."""
    return 0.5 * (F.relu(1 - real).mean() + F.relu(1 + fake).mean())


def hinge_generator(fake: Tensor) -> Tensor:
    """Mean max(0, 1 − D(fake)) of outputs (B, 1, h, w); a scalar."""
    return F.relu(1 - fake).mean()
