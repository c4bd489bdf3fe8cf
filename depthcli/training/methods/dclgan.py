"""DCLGAN (Han et al. 2021): contrast in both directions, each with its own patch heads."""

from typing import ClassVar, NamedTuple

import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.training.config import TrainConfig
from depthcli.training.data import TrainingBatch
from depthcli.training.losses import discriminator_loss, generator_loss, patch_nce, similarity
from depthcli.training.methods.base import (
    Method,
    Phase,
    frozen,
    generate,
    mean_over_taps,
    patch_heads,
    present,
    required,
)
from depthcli.training.networks.build import build_discriminator, build_generator
from depthcli.training.networks.patch import SimilarityMap


class Fakes(NamedTuple):
    """Both generate images, (B, 1, H, W)."""

    y: Tensor
    x: Tensor


class DomainFeatures(NamedTuple):
    """Feature maps (B, C, H, W) or patch vectors (B, P, dim) by tap, of real and fake images."""

    real_x: list[Tensor]
    fake_y: list[Tensor]
    real_y: list[Tensor]
    fake_x: list[Tensor]


class DclGan(Method):
    """GANs + contrast of x and G(x) + contrast of y and F(y) + identity.

    Gray images, real or fake, go through G's encoder and the first heads; depth maps through F's
    encoder and the second heads.
    """

    TERMS: ClassVar = frozenset({"adversarial", "contrast_x", "contrast_y", "identity"})
    phases: tuple[Phase, ...] = ("discriminator", "generator")

    def __init__(self, config: TrainConfig) -> None:
        super().__init__(config)
        self.backward_generator = build_generator(config.generator)
        adversarial = bool(self.weights.adversarial)
        self.depth_discriminator = build_discriminator(config) if adversarial else None
        self.gray_discriminator = build_discriminator(config) if adversarial else None
        self.taps = tuple(tap for tap in self.generator.TAPS if tap != "input")
        weights = self.weights
        compares = bool(weights.contrast_x or weights.contrast_y or weights.similarity)
        self.sampler_gray = patch_heads(self.generator, self.taps) if compares else None
        self.sampler_depth = patch_heads(self.generator, self.taps) if compares else None
        self._fakes: Fakes | None = None

    def networks(self, phase: Phase) -> list[nn.Module]:
        """G, F and the heads; or the discriminators."""
        if phase == "generator":
            return [self.generator, self.backward_generator, *self.heads()]
        return present(self.depth_discriminator, self.gray_discriminator)

    def heads(self) -> list[nn.Module]:
        """The patch heads of both domains."""
        return present(self.sampler_gray, self.sampler_depth)

    def forward(self, batch: TrainingBatch, phase: Phase) -> dict[str, Tensor]:
        """The discriminators' terms, or the generators'."""
        x, y = batch.network_input, self.encode(batch.depth_m)
        if phase == "discriminator":
            self._fakes = self._translate(x, y)  # the generators' phase, which is next, reuses it
            return self._discriminator_terms(x, y, self._fakes)
        fakes = self._fakes or self._translate(x, y)
        self._fakes = None
        compared = self._contrastive_terms(self._features(x, y, fakes)) if self.heads() else {}
        return self._adversarial(x, y, fakes) | self._identity(x, y) | compared

    def _translate(self, x: Tensor, y: Tensor) -> Fakes:
        return Fakes(generate(self.generator, x), generate(self.backward_generator, y))

    def _discriminator_terms(self, x: Tensor, y: Tensor, fakes: Fakes) -> dict[str, Tensor]:
        gan, fake_y, fake_x = self.weights.gan, fakes.y.detach(), fakes.x.detach()
        d_y, d_x = required(self.depth_discriminator), required(self.gray_discriminator)
        return {
            "depth_discriminator": discriminator_loss(gan, d_y, real=y, fake=fake_y),
            "gray_discriminator": discriminator_loss(gan, d_x, real=x, fake=fake_x),
        }

    def _adversarial(self, x: Tensor, y: Tensor, fakes: Fakes) -> dict[str, Tensor]:
        if self.depth_discriminator is None or self.gray_discriminator is None:
            return {}
        gan = self.weights.gan
        with frozen([self.depth_discriminator, self.gray_discriminator]):
            loss_y = generator_loss(gan, self.depth_discriminator, real=y, fake=fakes.y)
            loss_x = generator_loss(gan, self.gray_discriminator, real=x, fake=fakes.x)
        return {"adversarial": self.weights.adversarial * (loss_y + loss_x)}

    def _identity(self, x: Tensor, y: Tensor) -> dict[str, Tensor]:
        if not self.weights.identity:
            return {}
        same_y = F.l1_loss(generate(self.generator, y), y)
        same_x = F.l1_loss(generate(self.backward_generator, x), x)
        return {"identity": self.weights.identity * (same_y + same_x)}

    def _features(self, x: Tensor, y: Tensor, fakes: Fakes) -> DomainFeatures:
        of_gray, of_depth = self.generator.features, self.backward_generator.features
        taps = self.taps
        return DomainFeatures(
            of_gray(x, taps), of_depth(fakes.y, taps), of_depth(y, taps), of_gray(fakes.x, taps)
        )

    def _contrastive_terms(self, maps: DomainFeatures) -> dict[str, Tensor]:
        return self._contrast(self._patch_vectors(maps))

    def _contrast(self, vectors: DomainFeatures) -> dict[str, Tensor]:
        weights, terms = self.weights, {}
        if weights.contrast_x:
            there = mean_over_taps(patch_nce, vectors.fake_y, vectors.real_x)
            terms["contrast_x"] = weights.contrast_x * there
        if weights.contrast_y:
            back = mean_over_taps(patch_nce, vectors.fake_x, vectors.real_y)
            terms["contrast_y"] = weights.contrast_y * back
        return terms

    def _patch_vectors(self, maps: DomainFeatures) -> DomainFeatures:
        """Patch vectors at the same positions of an image and its translation."""
        of_gray, of_depth = required(self.sampler_gray), required(self.sampler_depth)
        real_x, positions_x = of_gray(maps.real_x)
        real_y, positions_y = of_depth(maps.real_y)
        fake_y, _ = of_depth(maps.fake_y, positions_x)
        fake_x, _ = of_gray(maps.fake_x, positions_y)
        return DomainFeatures(real_x, fake_y, real_y, fake_x)


class SimDcl(DclGan):
    """DCLGAN + the distance between one vector per real and per fake image, in both domains."""

    TERMS: ClassVar = DclGan.TERMS | {"similarity"}

    def __init__(self, config: TrainConfig) -> None:
        super().__init__(config)
        taps, compares = len(self.taps), bool(self.weights.similarity)
        self.map_real_x = SimilarityMap(taps) if compares else None
        self.map_fake_y = SimilarityMap(taps) if compares else None
        self.map_real_y = SimilarityMap(taps) if compares else None
        self.map_fake_x = SimilarityMap(taps) if compares else None

    def heads(self) -> list[nn.Module]:
        """The patch heads and the four maps."""
        maps = present(self.map_real_x, self.map_fake_y, self.map_real_y, self.map_fake_x)
        return super().heads() + maps

    def _contrastive_terms(self, maps: DomainFeatures) -> dict[str, Tensor]:
        vectors = self._patch_vectors(maps)
        if not self.weights.similarity:
            return self._contrast(vectors)
        # Fakes share no positions with the real images of their domain: sample new ones.
        fake_x, _ = required(self.sampler_gray)(maps.fake_x)
        fake_y, _ = required(self.sampler_depth)(maps.fake_y)
        alike = similarity(
            real_x=required(self.map_real_x)(vectors.real_x),
            fake_x=required(self.map_fake_x)(fake_x),
            real_y=required(self.map_real_y)(vectors.real_y),
            fake_y=required(self.map_fake_y)(fake_y),
        )
        return self._contrast(vectors) | {"similarity": self.weights.similarity * alike}
