"""The adversarial terms: what each form makes of a discriminator's outputs."""

import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn


def generator_loss(gan: str, judge: nn.Module, *, real: Tensor, fake: Tensor) -> Tensor:
    """How badly a fake deceives; a scalar.

    Args:
        gan: ``lsgan``, ``hinge`` or ``ralsgan``.
        judge: discriminator, images (B, 1, H, W) to outputs (B, 1, h, w).
        real: (B, 1, H, W) in [-1, 1]; looked at by the relativistic form only.
        fake: (B, 1, H, W), with gradient.
    """
    if gan == "ralsgan":
        return ralsgan_generator(judge(real).float(), judge(fake).float())
    return (lsgan_generator if gan == "lsgan" else hinge_generator)(judge(fake).float())


def discriminator_loss(gan: str, judge: nn.Module, *, real: Tensor, fake: Tensor) -> Tensor:
    """How badly a discriminator tells real from fake; a scalar. Arguments as above."""
    forms = {
        "lsgan": lsgan_discriminator,
        "hinge": hinge_discriminator,
        "ralsgan": ralsgan_discriminator,
    }
    return forms[gan](judge(real).float(), judge(fake).float())


# Least squares (eq. 5 and 6; Mao et al. 2017). All are of outputs (B, 1, h, w), to a scalar.


def lsgan_discriminator(real: Tensor, fake: Tensor) -> Tensor:
    """½(mean (D(real) − 1)² + mean D(fake)²)."""
    return 0.5 * (((real - 1) ** 2).mean() + (fake**2).mean())


def lsgan_generator(fake: Tensor) -> Tensor:
    """Mean (D(fake) − 1)²."""
    return ((fake - 1) ** 2).mean()


# Hinge, with the generator's margin of the DCLGAN family.


def hinge_discriminator(real: Tensor, fake: Tensor) -> Tensor:
    """½(mean max(0, 1 − D(real)) + mean max(0, 1 + D(fake)))."""
    return 0.5 * (F.relu(1 - real).mean() + F.relu(1 + fake).mean())


def hinge_generator(fake: Tensor) -> Tensor:
    """Mean max(0, 1 − D(fake))."""
    return F.relu(1 - fake).mean()


# Relativistic average least squares (Jolicoeur-Martineau 2018).


def ralsgan_discriminator(real: Tensor, fake: Tensor) -> Tensor:
    """½(mean (D(real) − mean D(fake) − 1)² + mean (D(fake) − mean D(real) + 1)²)."""
    return 0.5 * (((real - fake.mean() - 1) ** 2).mean() + ((fake - real.mean() + 1) ** 2).mean())


def ralsgan_generator(real: Tensor, fake: Tensor) -> Tensor:
    """The discriminator's loss with real and fake exchanged."""
    return ralsgan_discriminator(fake, real)
