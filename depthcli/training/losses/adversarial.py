"""Adversarial losses: LSGAN, hinge and relativistic average LSGAN."""

import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn


def generator_loss(gan: str, discriminator: nn.Module, *, real: Tensor, fake: Tensor) -> Tensor:
    """The generator's adversarial loss; a scalar.

    Args:
        gan: ``lsgan``, ``hinge`` or ``ralsgan``.
        discriminator: discriminator, images (B, 1, H, W) to outputs (B, 1, h, w).
        real: (B, 1, H, W) in [-1, 1]; used by the relativistic form only.
        fake: (B, 1, H, W), with gradient.
    """
    if gan == "ralsgan":
        return ralsgan_generator(discriminator(real).float(), discriminator(fake).float())
    return (lsgan_generator if gan == "lsgan" else hinge_generator)(discriminator(fake).float())


def discriminator_loss(gan: str, discriminator: nn.Module, *, real: Tensor, fake: Tensor) -> Tensor:
    """The discriminator's adversarial loss; a scalar. Arguments as above."""
    forms = {
        "lsgan": lsgan_discriminator,
        "hinge": hinge_discriminator,
        "ralsgan": ralsgan_discriminator,
    }
    return forms[gan](discriminator(real).float(), discriminator(fake).float())


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
