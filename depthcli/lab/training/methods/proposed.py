"""The paper's method (eq. 7): CycleGAN with contrast and a regularized L1 on paired depth."""

from functools import partial
from typing import ClassVar

from torch import Tensor, nn

from depthcli.lab.training import losses
from depthcli.lab.training.config import PAIRED_LOSSES, TrainConfig
from depthcli.lab.training.data import TrainingBatch
from depthcli.lab.training.methods import base
from depthcli.lab.training.methods.cyclegan import CycleGan, GeneratorOutputs


class Proposed(CycleGan):
    """Eq. 7; a weight of zero leaves the term and its networks out."""

    TERMS: ClassVar = CycleGan.TERMS | {"contrast_x", "contrast_y", "l1", "custom", *PAIRED_LOSSES}
    PAIRED: ClassVar = True

    def __init__(self, config: TrainConfig) -> None:
        super().__init__(config, backward=bool(config.loss.l1 and config.loss.l1_backward))
        contrast = self.weights.contrast_x or self.weights.contrast_y
        self.sampler = base.patch_heads(self.generator, self.generator.TAPS) if contrast else None

    def networks(self, phase: base.Phase) -> list[nn.Module]:
        """G, F and the patch heads; or the discriminators."""
        heads = base.present(self.sampler) if phase == "generator" else []
        return super().networks(phase) + heads

    def _terms(
        self, batch: TrainingBatch, y: Tensor, outputs: GeneratorOutputs
    ) -> dict[str, Tensor]:
        x, valid_mask, penalty = batch.network_input, batch.valid_mask, self.weights.weight_penalty
        raw_y = self._correct_pseudo_label_scale(outputs.raw_y, y, batch)
        terms = self.paired_terms(raw_y, y, valid_mask) | super()._terms(batch, y, outputs)
        if self.weights.l1 and self.weights.l1_backward:
            backward = base.required(self.backward_generator)
            l1 = losses.regularized_l1(
                base.required(outputs.fake_x), x, backward, penalty, valid_mask
            )
            terms["l1_backward"] = self.weights.l1 * l1
        return terms | self._contrastive_terms(x, y, outputs)

    def _correct_pseudo_label_scale(self, raw_y: Tensor, y: Tensor, batch: TrainingBatch) -> Tensor:
        """Remove part of the error in scale for pseudo labels (``pseudo_label_scale``).

        Of log depth, it is the mean difference from the truth.
        """
        if batch.is_pseudo_label is None:
            return raw_y
        difference = base.upsampled_like(y, raw_y) - raw_y
        if batch.valid_mask is not None:
            valid_mask = base.upsampled_like(batch.valid_mask.float(), raw_y)
            count = valid_mask.sum((1, 2, 3)).clamp(min=1)
            offset = (difference * valid_mask).sum((1, 2, 3)) / count
        else:
            offset = difference.mean((1, 2, 3))
        moved = batch.is_pseudo_label * (1 - self.weights.pseudo_label_scale) * offset
        return raw_y + moved[:, None, None, None]

    def _contrastive_terms(
        self, x: Tensor, y: Tensor, outputs: GeneratorOutputs
    ) -> dict[str, Tensor]:
        """Eq. 4: features of the output against those of the input or of the paired truth."""
        patches = partial(base.compared_patches, self.generator, self.sampler)
        is_paired, nce = self.weights.contrast == "cfl", losses.patch_nce
        loss, source = (losses.cfl_nce, y) if is_paired else (nce, x)
        of_x = partial(patches, source, outputs.fake_y)
        return self.weighted(
            contrast_x=lambda: base.mean_over_taps(loss, *of_x()),
            contrast_y=lambda: base.mean_over_taps(nce, *patches(y, base.required(outputs.same_y))),
        )
