"""CUT, FastCUT (Park et al. 2020) and HnegSRC (Jung et al. 2022): patch-wise contrast, one way."""

from collections.abc import Callable
from functools import cache, partial
from typing import ClassVar, TypeAlias

import torch
from torch import Tensor, nn

from depthcli.lab.training import losses
from depthcli.lab.training.config import TrainConfig
from depthcli.lab.training.data import TrainingBatch
from depthcli.lab.training.methods import base
from depthcli.lab.training.networks.build import build_discriminator

_Patches: TypeAlias = Callable[[], tuple[list[Tensor], list[Tensor]]]


class Cut(base.Method):
    """GAN + contrast of x and G(x) + contrast of y and G(y).

    With ``flip_contrast`` (FastCUT), half of the steps mirror G's input; its features are mirrored
    back and compared with those of the original image.
    """

    TERMS: ClassVar = frozenset({"adversarial", "contrast_x", "contrast_y"})
    phases: tuple[base.Phase, ...] = ("discriminator", "generator")

    def __init__(self, config: TrainConfig) -> None:
        super().__init__(config)
        self.discriminator = build_discriminator(config) if self.weights.adversarial else None
        compares = self.weights.contrast_x or self.weights.contrast_y or self.weights.relation
        self.sampler = base.patch_heads(self.generator, self.generator.TAPS) if compares else None
        self._fakes: tuple[Tensor, bool] | None = None

    def networks(self, phase: base.Phase) -> list[nn.Module]:
        """G and the patch heads; or the discriminator."""
        if phase == "generator":
            return base.present(self.generator, self.sampler)
        return base.present(self.discriminator)

    def forward(self, batch: TrainingBatch, phase: base.Phase) -> dict[str, Tensor]:
        """The discriminator's term, or the generator's."""
        x, y = batch.network_input, self.encode(batch.depth_m)
        if phase == "discriminator":
            self._fakes = self._translate(x)  # the generator's phase, which is next, reuses it
            fake_y, judge = self._fakes[0].detach(), base.required(self.discriminator)
            loss = losses.discriminator_loss(self.weights.gan, judge, real=y, fake=fake_y)
            return {"discriminator": loss}
        fake_y, flipped = self._fakes or self._translate(x)
        self._fakes = None
        patches = partial(base.compared_patches, self.generator, self.sampler)
        of_x = partial(patches, x, fake_y, is_mirrored=flipped)
        adversarial = partial(self.judged, self.discriminator, real=y, fake=fake_y)
        return self.weighted(adversarial=adversarial) | self._contrastive_terms(
            of_x, lambda: patches(y, base.generate(self.generator, y))
        )

    def _translate(self, x: Tensor) -> tuple[Tensor, bool]:
        flipped = self.weights.flip_contrast and bool(torch.rand(()) < 0.5)  # noqa: PLR2004
        return base.generate(self.generator, x.flip(3) if flipped else x), flipped

    def _contrastive_terms(self, of_x: _Patches, of_y: _Patches) -> dict[str, Tensor]:
        return self.weighted(
            contrast_x=lambda: base.mean_over_taps(losses.patch_nce, *of_x()),
            contrast_y=lambda: base.mean_over_taps(losses.patch_nce, *of_y()),
        )


class HnegSrc(Cut):
    """GAN + hDCE of x and G(x) + hDCE of y and G(y) + SRC of x and G(x)."""

    TERMS: ClassVar = Cut.TERMS | {"relation"}

    @property
    def gamma(self) -> float:
        """γ of the negatives' weights, linear over the schedule: they become harder."""
        start, end = self.weights.gamma_start, self.weights.gamma_end
        return start + (end - start) * self.share_done

    def _contrastive_terms(self, of_x: _Patches, of_y: _Patches) -> dict[str, Tensor]:
        of_x, hard = cache(of_x), partial(losses.hdce, gamma=self.gamma)
        return self.weighted(
            contrast_x=lambda: base.mean_over_taps(hard, *of_x()),
            relation=lambda: base.mean_over_taps(losses.semantic_relation, *of_x()),
            contrast_y=lambda: base.mean_over_taps(hard, *of_y()),
        )
