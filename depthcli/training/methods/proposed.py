"""The paper's method (eq. 7): CycleGAN with contrast and a regularised L1 on paired depth."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import torch.nn.functional as F  # noqa: N812

from depthcli.training.losses.gradient import gradient_loss
from depthcli.training.losses.patchnce import cfl_nce, patch_nce
from depthcli.training.losses.regularised_l1 import regularised_l1
from depthcli.training.methods.base import Phase, present
from depthcli.training.methods.contrast import mean_over_taps, patch_heads
from depthcli.training.methods.cyclegan import CycleGan, Made

if TYPE_CHECKING:
    from collections.abc import Callable

    from torch import Tensor, nn

    from depthcli.training.config import TrainConfig


class Proposed(CycleGan):
    """Eq. 7, and any part of it: a weight of zero leaves the term and its networks out."""

    TERMS: ClassVar = CycleGan.TERMS | {"contrast_x", "contrast_y", "l1", "gradient"}

    def __init__(self, config: TrainConfig) -> None:
        super().__init__(config)
        contrast = self.weights.contrast_x or self.weights.contrast_y
        self.sampler = patch_heads(self.generator, self.generator.TAPS) if contrast else None

    @property
    def _both_ways(self) -> bool:
        return super()._both_ways or self.weights.l1_backward

    def networks(self, phase: Phase) -> list[nn.Module]:
        """G, F and the patch heads; or the discriminators."""
        networks = super().networks(phase)
        if phase == "generator" and self.sampler is not None:
            networks.append(self.sampler)
        return networks

    def _terms(self, x: Tensor, y: Tensor, made: Made) -> dict[str, Tensor]:
        """Weighted terms of eq. 7."""
        terms = self._supervised(made.raw_y, y) | super()._terms(x, y, made)
        if self.weights.l1_backward:
            backward = present(self.backward_generator)
            l1 = regularised_l1(present(made.fake_x), x, backward, self.weights.weight_penalty)
            terms["l1_backward"] = self.weights.l1 * l1
        return terms | self._contrasted(x, y, made)

    def _supervised(self, raw_y: Tensor, y: Tensor) -> dict[str, Tensor]:
        weights, terms = self.weights, {}
        smaller = raw_y.shape[2:] != y.shape[2:]
        truth = F.interpolate(y, size=raw_y.shape[2:], mode="area") if smaller else y
        if weights.l1:
            l1 = regularised_l1(raw_y, truth, self.generator, weights.weight_penalty)
            terms["l1"] = weights.l1 * l1
        if weights.gradient:
            terms["gradient"] = weights.gradient * gradient_loss(raw_y, truth)
        return terms

    def _contrasted(self, x: Tensor, y: Tensor, made: Made) -> dict[str, Tensor]:
        """Eq. 4: features of the output against those of the input, or of the paired truth."""
        weights, terms = self.weights, {}
        if weights.contrast_x:
            paired = weights.contrast == "cfl"
            loss, source = (cfl_nce, y) if paired else (patch_nce, x)
            terms["contrast_x"] = weights.contrast_x * self._contrast(loss, source, made.fake_y)
        if weights.contrast_y:
            same_y = present(made.same_y)
            terms["contrast_y"] = weights.contrast_y * self._contrast(patch_nce, y, same_y)
        return terms

    def _contrast(
        self, loss: Callable[[Tensor, Tensor], Tensor], source: Tensor, output: Tensor
    ) -> Tensor:
        sampler = present(self.sampler)
        keys, positions = sampler(self.generator.features(source))
        queries, _ = sampler(self.generator.features(output), positions)
        return mean_over_taps(loss, queries, keys)
