"""DCLGAN and SimDCL (Han et al. 2021): contrast both ways, each way with its own patch heads."""

from typing import ClassVar, NamedTuple

from torch import Tensor, nn

from depthcli.lab.training.config import TrainConfig
from depthcli.lab.training.data import TrainingBatch
from depthcli.lab.training.losses import patch_nce, similarity
from depthcli.lab.training.methods import base
from depthcli.lab.training.networks.build import Generator
from depthcli.lab.training.networks.patch import SimilarityMap


class DomainFeatures(NamedTuple):
    """Feature maps (B, C, H, W) or patch vectors (B, P, dim) by tap, of real and fake images."""

    real_x: list[Tensor]
    fake_y: list[Tensor]
    real_y: list[Tensor]
    fake_x: list[Tensor]


class DclGan(base.TwoWay):
    """GANs + contrast of x and G(x) + contrast of y and F(y) + identity.

    G's encoder and the first heads take gray images, real or fake; F's and the second depth maps.
    """

    TERMS: ClassVar = frozenset({"adversarial", "contrast_x", "contrast_y", "identity"})
    phases: tuple[base.Phase, ...] = ("discriminator", "generator")
    backward_generator: Generator

    def __init__(self, config: TrainConfig) -> None:
        super().__init__(config, backward=True, gray_discriminator=True)
        self.taps = tuple(tap for tap in self.generator.TAPS if tap != "input")
        weights = self.weights
        compares = bool(weights.contrast_x or weights.contrast_y or weights.similarity)
        self.sampler_gray = base.patch_heads(self.generator, self.taps) if compares else None
        self.sampler_depth = base.patch_heads(self.generator, self.taps) if compares else None
        self._fakes: tuple[Tensor, Tensor] | None = None

    def heads(self) -> list[nn.Module]:
        """The patch heads of both domains."""
        return base.present(self.sampler_gray, self.sampler_depth)

    def forward(self, batch: TrainingBatch, phase: base.Phase) -> dict[str, Tensor]:
        """The discriminators' terms, or the generators'."""
        x, y, forward = batch.network_input, self.encode(batch.depth_m), self.generator
        backward = self.backward_generator
        fake_y, fake_x = self._fakes or (base.generate(forward, x), base.generate(backward, y))
        if phase == "discriminator":
            self._fakes = fake_y, fake_x  # the generators' phase, which is next, reuses them
            return self.discriminator_terms(x, y, fake_x.detach(), fake_y.detach())
        self._fakes = None
        compared = {}
        if self.heads():
            maps = DomainFeatures(
                real_x=forward.features(x, self.taps),
                fake_y=backward.features(fake_y, self.taps),
                real_y=backward.features(y, self.taps),
                fake_x=forward.features(fake_x, self.taps),
            )
            compared = self._contrastive_terms(maps, self._patch_vectors(maps))
        same_y = base.generate(forward, y) if self.weights.identity else None
        terms = self.adversarial_terms(x, y, fake_x, fake_y) | self.identity_terms(x, y, same_y)
        return terms | compared

    def _contrastive_terms(
        self, maps: DomainFeatures, vectors: DomainFeatures
    ) -> dict[str, Tensor]:
        del maps  # for SimDCL
        return self.weighted(
            contrast_x=lambda: base.mean_over_taps(patch_nce, vectors.fake_y, vectors.real_x),
            contrast_y=lambda: base.mean_over_taps(patch_nce, vectors.fake_x, vectors.real_y),
        )

    def _patch_vectors(self, maps: DomainFeatures) -> DomainFeatures:
        """Patch vectors at the same positions of an image and its translation."""
        of_gray, of_depth = base.required(self.sampler_gray), base.required(self.sampler_depth)
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
        for name in DomainFeatures._fields:
            network = SimilarityMap(len(self.taps)) if self.weights.similarity else None
            setattr(self, f"map_{name}", network)

    def heads(self) -> list[nn.Module]:
        """The patch heads and the four maps."""
        maps = (getattr(self, f"map_{name}") for name in DomainFeatures._fields)
        return super().heads() + base.present(*maps)

    def _contrastive_terms(
        self, maps: DomainFeatures, vectors: DomainFeatures
    ) -> dict[str, Tensor]:
        def similar() -> Tensor:
            # Fakes share no positions with the real images of their domain: sample new ones.
            fake_x, _ = base.required(self.sampler_gray)(maps.fake_x)
            fake_y, _ = base.required(self.sampler_depth)(maps.fake_y)
            taps = vectors._replace(fake_x=fake_x, fake_y=fake_y)._asdict()
            return similarity(**{name: getattr(self, f"map_{name}")(taps[name]) for name in taps})

        return super()._contrastive_terms(maps, vectors) | self.weighted(similarity=similar)
