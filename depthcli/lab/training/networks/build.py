"""Building networks from a configuration."""

from depthcli.lab.training.config import GeneratorConfig, TrainConfig
from depthcli.lab.training.networks.efficient import EfficientGenerator
from depthcli.lab.training.networks.encoder import EncoderGenerator
from depthcli.lab.training.networks.patch import PatchGan
from depthcli.lab.training.networks.prompted import PromptedGenerator
from depthcli.lab.training.networks.resnet import ResnetGenerator

Generator = EfficientGenerator | EncoderGenerator | ResnetGenerator


def build_network(config: GeneratorConfig, channels: int = 1) -> Generator | PromptedGenerator:
    """The generator of a configuration, with the layers that take known depth, if it has some."""
    generator = build_generator(config, channels)
    if config.prompt and not isinstance(generator, ResnetGenerator):
        return PromptedGenerator(generator, config.prompt)
    return generator


def build_generator(config: GeneratorConfig, channels: int = 1, outputs: int = 1) -> Generator:
    """A new generator without layers for known depth; only a ``resnet`` has other ``outputs``."""
    if config.name == "encoder":
        return EncoderGenerator(config, channels)
    if config.name == "efficient":
        return EfficientGenerator(config)
    return ResnetGenerator(config, channels, outputs)


def build_discriminator(config: TrainConfig, channels: int = 1) -> PatchGan:
    """A discriminator of the same family as the generator, newly initialized."""
    return PatchGan(
        channels, width=config.optim.width_discriminator, antialias=config.generator.antialias
    )
