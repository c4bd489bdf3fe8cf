"""Relativistic average least-squares GAN (Jolicoeur-Martineau 2018)."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor


def ralsgan_discriminator(real: Tensor, fake: Tensor) -> Tensor:
    """½(mean (D(real) − mean D(fake) − 1)² + mean (D(fake) − mean D(real) + 1)²)."""
    return 0.5 * (((real - fake.mean() - 1) ** 2).mean() + ((fake - real.mean() + 1) ** 2).mean())


def ralsgan_generator(real: Tensor, fake: Tensor) -> Tensor:
    """The discriminator's loss with real and fake exchanged."""
    return ralsgan_discriminator(fake, real)
