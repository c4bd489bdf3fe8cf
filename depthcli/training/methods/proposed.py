"""The paper's method (eq. 7): CycleGAN with contrast and a regularised L1 on paired depth."""

from collections.abc import Callable
from typing import ClassVar

import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.training.config.objective import PAIRED_LOSSES
from depthcli.training.config.schema import TrainConfig
from depthcli.training.data.batches import TrainingBatch
from depthcli.training.losses.paired import paired_losses
from depthcli.training.losses.patchnce import cfl_nce, patch_nce
from depthcli.training.losses.regularised_l1 import regularised_l1
from depthcli.training.methods.base import Phase, not_none, present, sized
from depthcli.training.methods.contrast import mean_over_taps, patch_heads
from depthcli.training.methods.cyclegan import CycleGan, Made


class Proposed(CycleGan):
    """Eq. 7, and any part of it: a weight of zero leaves the term and its networks out."""

    TERMS: ClassVar = CycleGan.TERMS | {"contrast_x", "contrast_y", "l1", *PAIRED_LOSSES}
    SETTINGS: ClassVar = CycleGan.SETTINGS | {
        "loss.adversarial_backward",
        "loss.contrast",
        "loss.l1_backward",
        "loss.weight_penalty",
    }
    PAIRED: ClassVar = True

    def __init__(self, config: TrainConfig) -> None:
        super().__init__(config)
        contrast = self.weights.contrast_x or self.weights.contrast_y
        self.sampler = patch_heads(self.generator, self.generator.TAPS) if contrast else None
        self._paired = paired_losses(self.weights)

    @property
    def _both_ways(self) -> bool:
        return super()._both_ways or self._backward_l1

    @property
    def _backward_l1(self) -> bool:
        return bool(self.weights.l1 and self.weights.l1_backward)

    def networks(self, phase: Phase) -> list[nn.Module]:
        """G, F and the patch heads; or the discriminators."""
        heads = not_none(self.sampler) if phase == "generator" else []
        return super().networks(phase) + heads

    def _terms(self, batch: TrainingBatch, y: Tensor, made: Made) -> dict[str, Tensor]:
        """Weighted terms of eq. 7."""
        x, known, penalty = batch.gray, batch.known, self.weights.weight_penalty
        raw_y = self._scaled(made.raw_y, y, batch)
        terms = self._supervised(raw_y, y, known) | super()._terms(batch, y, made)
        if self._backward_l1:
            backward = present(self.backward_generator)
            l1 = regularised_l1(present(made.fake_x), x, backward, penalty, known)
            terms["l1_backward"] = self.weights.l1 * l1
        return terms | self._contrasted(x, y, made)

    def _scaled(self, raw_y: Tensor, y: Tensor, batch: TrainingBatch) -> Tensor:
        """The output, where an extra pair's metres count in part, moved towards its mean truth.

        With log depth the mean difference is the error in scale.
        """
        if batch.extra is None:
            return raw_y
        difference = sized(y, raw_y) - raw_y
        if batch.known is not None:
            known = sized(batch.known.float(), raw_y)
            offset = (difference * known).sum((1, 2, 3)) / known.sum((1, 2, 3)).clamp(min=1)
        else:
            offset = difference.mean((1, 2, 3))
        moved = batch.extra * (1 - self.weights.extra_scale) * offset
        return raw_y + moved[:, None, None, None]

    def _supervised(self, raw_y: Tensor, y: Tensor, known: Tensor | None) -> dict[str, Tensor]:
        """Eq. 1 and the other comparisons with the truth, of measured pixels alone."""
        weights, terms, size = self.weights, {}, raw_y.shape[2:]
        if size != y.shape[2:]:
            y = F.interpolate(y, size=size, mode="area")
            known = (
                None if known is None else F.interpolate(known.float(), size=size, mode="area") == 1
            )
        if weights.l1:
            l1 = regularised_l1(raw_y, y, self.generator, weights.weight_penalty, known)
            terms["l1"] = weights.l1 * l1
        for name, loss in self._paired.items():
            terms[name] = getattr(weights, name) * loss(raw_y, y, known)
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
