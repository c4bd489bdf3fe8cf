"""Least-squares GAN (eq. 5 and 6; Mao et al. 2017)."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor


def lsgan_discriminator(real: Tensor, fake: Tensor) -> Tensor:
    """½(mean (D(real) − 1)² + mean D(fake)²) of outputs (B, 1, h, w); a scalar."""
    return 0.5 * (((real - 1) ** 2).mean() + (fake**2).mean())


def lsgan_generator(fake: Tensor) -> Tensor:
    """Mean (D(fake) − 1)² of outputs (B, 1, h, w); a scalar."""
    return ((fake - 1) ** 2).mean()
