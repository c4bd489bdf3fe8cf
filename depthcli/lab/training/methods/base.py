"""The interface of a training method, and functions that the methods share."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from functools import partial
from typing import ClassVar, Literal, TypeVar

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.lab.training import losses
from depthcli.lab.training.config import PAIRED_LOSSES, TrainConfig
from depthcli.lab.training.data import TrainingBatch
from depthcli.lab.training.losses import discriminator_loss, generator_loss
from depthcli.lab.training.networks.build import Generator, build_discriminator, build_generator
from depthcli.lab.training.networks.patch import PatchSampler
from depthcli.lab.training.plugins import imported

Phase = Literal["generator", "discriminator"]
_Part = TypeVar("_Part")


class Method(nn.Module):
    """Networks and losses of one method.

    ``forward(batch, phase)`` returns the weighted loss terms of a phase; the training loop
    minimizes their sum over the networks of that phase.

    Attributes:
        TERMS: the weights of ``LossConfig`` that the method uses; others have to be zero.
        PAIRED: whether it can be trained with aligned pairs of image and depth map.
        phases: the order of the two half steps.
        generator: G, gray to depth: the network that is validated and exported.
        share_done: fraction of the schedule that is done, in [0, 1); set by the training loop.
    """

    TERMS: ClassVar[frozenset[str]]
    PAIRED: ClassVar[bool] = False
    phases: tuple[Phase, ...]

    def __init__(self, config: TrainConfig) -> None:
        super().__init__()
        self.config, self.weights = config, config.loss
        self.codec = config.output.codec
        self.share_done = 0.0
        self.generator: Generator = build_generator(config.generator, config.data.channels)
        self._custom_losses = {name: imported(name) for name in config.loss.custom}

    @abstractmethod
    def networks(self, phase: Phase) -> list[nn.Module]:
        """The networks that a phase optimizes; none if the phase has nothing to do."""

    def heads(self) -> list[nn.Module]:
        """Networks that use ``head_learning_rate``, if that is set."""
        return []

    @abstractmethod
    def forward(self, batch: TrainingBatch, phase: Phase) -> dict[str, Tensor]:
        """Weighted loss terms by name, each a scalar."""

    def extra_state(self) -> dict[str, list[Tensor]]:
        """State beyond the networks' weights, such as image pools, by name."""
        return {}

    def load_extra_state(self, state: dict[str, list[Tensor]]) -> None:
        """Restore what :meth:`extra_state` returned."""

    def weighted(self, **losses: Callable[[], Tensor]) -> dict[str, Tensor]:
        """Weighted terms of losses, each named as its weight; a weight of zero leaves it out."""
        weights = {name: getattr(self.weights, name) for name in losses}
        return {name: weights[name] * loss() for name, loss in losses.items() if weights[name]}

    def judged(self, discriminator: nn.Module | None, *, real: Tensor, fake: Tensor) -> Tensor:
        """The generator's adversarial loss by a discriminator, whose weights do not change."""
        judge = required(discriminator).requires_grad_(False)
        loss = generator_loss(self.weights.gan, judge, real=real, fake=fake)
        judge.requires_grad_(True)
        return loss

    def paired_terms(
        self, raw_y: Tensor, y: Tensor, valid_mask: Tensor | None
    ) -> dict[str, Tensor]:
        """Eq. 1 and the other losses against ground truth, over pixels with valid depth."""
        size = raw_y.shape[2:]
        if size != y.shape[2:]:
            y = F.interpolate(y, size=size, mode="area")
            if valid_mask is not None:
                valid_mask = F.interpolate(valid_mask.float(), size=size, mode="area") == 1
        penalty = self.weights.weight_penalty
        l1 = partial(losses.regularized_l1, generator=self.generator, penalty=penalty)
        others = {name: getattr(losses, function) for name, function in PAIRED_LOSSES.items()}
        terms = {
            name: partial(loss, raw_y, y, valid_mask=valid_mask)
            for name, loss in {"l1": l1, **others}.items()
        }
        return self.weighted(**terms) | self.custom_terms(raw_y, y, valid_mask)

    def custom_terms(
        self, prediction: Tensor, truth: Tensor, valid_mask: Tensor | None
    ) -> dict[str, Tensor]:
        """Weighted terms of ``loss.custom``; coded depth (B, 1, H, W), and its valid pixels."""
        return {
            name: weight * self._custom_losses[name](prediction, truth, valid_mask)
            for name, weight in self.weights.custom.items()
        }

    def encode(self, depth_m: Tensor) -> Tensor:
        """Depth (B, 1, H, W) in metres to the networks' coding in [-1, 1]."""
        output = self.config.output
        nearest_m = output.min_m if output.coding == "log" else 0.0
        depth_m = depth_m.clamp(nearest_m, output.max_m)
        t = torch.log(depth_m) if output.coding == "log" else depth_m
        return (t - self.codec.shift) / self.codec.scale


class TwoWay(Method):
    """Generators G, gray to depth, and F back; discriminators D_y of depth and D_x of gray images.

    What no loss term needs is None.
    """

    def __init__(self, config: TrainConfig, *, backward: bool, gray_discriminator: bool) -> None:
        super().__init__(config)
        judges, channels = bool(self.weights.adversarial), config.data.channels
        self.backward_generator: Generator | None = (
            build_generator(config.generator, channels, outputs=channels) if backward else None
        )
        self.depth_discriminator = build_discriminator(config) if judges else None
        self.gray_discriminator = (
            build_discriminator(config, channels) if judges and gray_discriminator else None
        )

    def networks(self, phase: Phase) -> list[nn.Module]:
        """G, F and the heads; or the discriminators."""
        if phase == "generator":
            return present(self.generator, self.backward_generator, *self.heads())
        return present(self.depth_discriminator, self.gray_discriminator)

    def adversarial_terms(
        self, x: Tensor, y: Tensor, fake_x: Tensor | None, fake_y: Tensor
    ) -> dict[str, Tensor]:
        """The generators' half of eq. 5 and 6."""

        def adversarial() -> Tensor:
            loss = self.judged(self.depth_discriminator, real=y, fake=fake_y)
            if self.gray_discriminator is None:
                return loss
            return loss + self.judged(self.gray_discriminator, real=x, fake=required(fake_x))

        return self.weighted(adversarial=adversarial)

    def discriminator_terms(
        self, x: Tensor, y: Tensor, fake_x: Tensor | None, fake_y: Tensor
    ) -> dict[str, Tensor]:
        """The discriminators' half of eq. 5 and 6; the fakes are detached."""
        judged = {
            "gray_discriminator": (self.gray_discriminator, x, fake_x),
            "depth_discriminator": (self.depth_discriminator, y, fake_y),
        }
        return {
            name: discriminator_loss(self.weights.gan, network, real=real, fake=fake)
            for name, (network, real, fake) in judged.items()
            if network is not None and fake is not None
        }

    def identity_terms(self, x: Tensor, y: Tensor, same_y: Tensor | None) -> dict[str, Tensor]:
        """Eq. 3; ``same_y`` is G(y)."""

        def identity() -> Tensor:
            same_x = F.l1_loss(generate(required(self.backward_generator), x), x)
            return F.l1_loss(required(same_y), y) + same_x

        return self.weighted(identity=identity)


def generate(generator: nn.Module, image: Tensor) -> Tensor:
    """A generator's output (B, 1, H, W), fp32, upsampled to its input's size if it is smaller."""
    return upsampled_like(generator(image).float(), image)


def upsampled_like(image: Tensor, like: Tensor) -> Tensor:
    """Upsample an image (B, C, h, w) bilinearly to the size of another, if it is smaller."""
    if image.shape[2:] == like.shape[2:]:
        return image
    return F.interpolate(image, size=like.shape[2:], mode="bilinear", align_corners=False)


def required(part: _Part | None) -> _Part:
    """A network or an output that a loss with a weight above zero needs."""
    if part is None:
        raise ValueError("a weight above zero builds what its loss needs")
    return part


def present(*networks: nn.Module | None) -> list[nn.Module]:
    """The networks that exist; those of losses with a weight of zero are None."""
    return [network for network in networks if network is not None]


def patch_heads(generator: Generator, taps: Sequence[str]) -> PatchSampler:
    """Newly initialized heads for some taps of a generator."""
    return PatchSampler([generator.tap_channels(tap) for tap in taps])


def compared_patches(
    generator: Generator,
    sampler: PatchSampler | None,
    source: Tensor,
    output: Tensor,
    *,
    is_mirrored: bool = False,
) -> tuple[list[Tensor], list[Tensor]]:
    """Patch vectors (B, P, dim) of each tap: queries of the output, keys of the source."""
    sampler = required(sampler)
    keys, positions = sampler(generator.features(source))
    maps = generator.features(output)
    maps = [features.flip(3) for features in maps] if is_mirrored else maps
    return sampler(maps, positions)[0], keys


def mean_over_taps(
    loss: Callable[[Tensor, Tensor], Tensor], queries: Sequence[Tensor], keys: Sequence[Tensor]
) -> Tensor:
    """Mean over the taps of a contrastive loss of patch vectors (B, P, dim); a scalar."""
    return torch.stack([loss(q, k) for q, k in zip(queries, keys, strict=True)]).mean()
