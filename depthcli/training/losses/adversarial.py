"""The adversarial terms by name: what each form makes of a discriminator's outputs."""

from torch import Tensor, nn

from depthcli.training.losses.hinge import hinge_discriminator, hinge_generator
from depthcli.training.losses.lsgan import lsgan_discriminator, lsgan_generator
from depthcli.training.losses.ralsgan import ralsgan_discriminator, ralsgan_generator


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
