"""DCLGAN (Han et al. 2021): contrast in both directions, each with its own patch heads."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, NamedTuple

import torch.nn.functional as F  # noqa: N812

from depthcli.training.losses.adversarial import discriminator_loss, generator_loss
from depthcli.training.losses.patchnce import patch_nce
from depthcli.training.methods.base import Method, Phase, frozen, translated
from depthcli.training.methods.contrast import mean_over_taps, patch_heads
from depthcli.training.networks.build import build_discriminator, build_generator

if TYPE_CHECKING:
    from torch import Tensor, nn

    from depthcli.training.batches import Batch
    from depthcli.training.config import TrainConfig


class Fakes(NamedTuple):
    """Both translations, (B, 1, H, W)."""

    y: Tensor
    x: Tensor


class Vectors(NamedTuple):
    """Patch vectors (B, P, dim) of each tap, of both pictures and both translations."""

    real_x: list[Tensor]
    fake_y: list[Tensor]
    real_y: list[Tensor]
    fake_x: list[Tensor]


class DclGan(Method):
    """GANs + contrast of x and G(x) + contrast of y and F(y) + identity.

    Gray goes through G's encoder and the first heads, depth through F's encoder and the second,
    whether real or made.
    """

    TERMS: ClassVar = frozenset({"adversarial", "contrast_x", "contrast_y", "identity"})
    phases: tuple[Phase, ...] = ("discriminator", "generator")

    def __init__(self, config: TrainConfig) -> None:
        super().__init__(config)
        self.backward_generator = build_generator(config.generator)
        self.judge_depth, self.judge_gray = build_discriminator(config), build_discriminator(config)
        self.taps = tuple(tap for tap in self.generator.TAPS if tap != "input")
        self.sampler_gray = patch_heads(self.generator, self.taps)
        self.sampler_depth = patch_heads(self.generator, self.taps)
        self._made: Fakes | None = None

    def networks(self, phase: Phase) -> list[nn.Module]:
        """G, F and the heads; or the discriminators."""
        if phase == "generator":
            return [self.generator, self.backward_generator, *self.heads()]
        return [self.judge_depth, self.judge_gray]

    def heads(self) -> list[nn.Module]:
        """The patch heads of both domains."""
        return [self.sampler_gray, self.sampler_depth]

    def forward(self, batch: Batch, phase: Phase) -> dict[str, Tensor]:
        """The discriminators' terms, or the generators'."""
        x, y = batch.gray, self.encode(batch.depth_m)
        if phase == "discriminator":
            self._made = self._translate(x, y)  # not moved in between: the next phase takes it up
            return self._judge(x, y, self._made)
        fakes = self._made or self._translate(x, y)
        self._made = None
        compared = self._compared(self._vectors(x, y, fakes))
        return self._deceive(x, y, fakes) | self._identity(x, y) | compared

    def _translate(self, x: Tensor, y: Tensor) -> Fakes:
        return Fakes(translated(self.generator, x), translated(self.backward_generator, y))

    def _judge(self, x: Tensor, y: Tensor, fakes: Fakes) -> dict[str, Tensor]:
        gan, fake_y, fake_x = self.weights.gan, fakes.y.detach(), fakes.x.detach()
        return {
            "judge_depth": discriminator_loss(gan, self.judge_depth, real=y, fake=fake_y),
            "judge_gray": discriminator_loss(gan, self.judge_gray, real=x, fake=fake_x),
        }

    def _deceive(self, x: Tensor, y: Tensor, fakes: Fakes) -> dict[str, Tensor]:
        gan = self.weights.gan
        with frozen(self.networks("discriminator")):
            loss_y = generator_loss(gan, self.judge_depth, real=y, fake=fakes.y)
            loss_x = generator_loss(gan, self.judge_gray, real=x, fake=fakes.x)
        return {"adversarial": self.weights.adversarial * (loss_y + loss_x)}

    def _identity(self, x: Tensor, y: Tensor) -> dict[str, Tensor]:
        if not self.weights.identity:
            return {}
        same_y = F.l1_loss(translated(self.generator, y), y)
        same_x = F.l1_loss(translated(self.backward_generator, x), x)
        return {"identity": self.weights.identity * (same_y + same_x)}

    def _compared(self, vectors: Vectors) -> dict[str, Tensor]:
        there = mean_over_taps(patch_nce, vectors.fake_y, vectors.real_x)
        back = mean_over_taps(patch_nce, vectors.fake_x, vectors.real_y)
        weights = self.weights
        return {"contrast_x": weights.contrast_x * there, "contrast_y": weights.contrast_y * back}

    def _vectors(self, x: Tensor, y: Tensor, fakes: Fakes) -> Vectors:
        """The same positions for a picture and its translation."""
        real_x, positions_x = self.sampler_gray(self.generator.features(x, self.taps))
        real_y, positions_y = self.sampler_depth(self.backward_generator.features(y, self.taps))
        maps_y = self.backward_generator.features(fakes.y, self.taps)
        maps_x = self.generator.features(fakes.x, self.taps)
        fake_y, _ = self.sampler_depth(maps_y, positions_x)
        fake_x, _ = self.sampler_gray(maps_x, positions_y)
        return Vectors(real_x, fake_y, real_y, fake_x)
