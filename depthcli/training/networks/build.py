"""Networks by configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli.training.networks.efficient import EfficientGenerator
from depthcli.training.networks.resnet import ResnetGenerator

if TYPE_CHECKING:
    from depthcli.training.config import GeneratorConfig


def build_generator(config: GeneratorConfig) -> EfficientGenerator | ResnetGenerator:
    """The generator that a configuration describes, with fresh weights."""
    if config.name == "efficient":
        return EfficientGenerator(config.encoder, config.decoder, config.depths, config.dropout)
    return ResnetGenerator(
        width=config.width,
        blocks=config.blocks,
        antialias=config.antialias,
        residual=config.residual,
    )
