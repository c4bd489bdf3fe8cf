"""HnegSRC (Jung et al. 2022): CUT with hard negatives and semantic relation consistency."""

from functools import partial
from typing import ClassVar

from torch import Tensor

from depthcli.training.losses.hdce import hdce
from depthcli.training.losses.semantic_relation import semantic_relation
from depthcli.training.methods.base import generate
from depthcli.training.methods.contrast import mean_over_taps
from depthcli.training.methods.cut import Cut


class HnegSrc(Cut):
    """GAN + hDCE of x and G(x) + hDCE of y and G(y) + SRC of x and G(x)."""

    TERMS: ClassVar = Cut.TERMS | {"relation"}
    SETTINGS: ClassVar = Cut.SETTINGS | {"loss.gamma_start", "loss.gamma_end"}

    @property
    def gamma(self) -> float:
        """γ of the negatives' weights, linear over the schedule: they become harder."""
        start, end = self.weights.gamma_start, self.weights.gamma_end
        return start + (end - start) * self.share_done

    def _contrastive_terms(
        self, x: Tensor, y: Tensor, fake_y: Tensor, *, flipped: bool
    ) -> dict[str, Tensor]:
        terms, weights = {}, self.weights
        hard = partial(hdce, gamma=self.gamma)
        if weights.contrast_x or weights.relation:
            vectors = self._patch_vectors(x, fake_y, flipped=flipped)
        if weights.contrast_x:
            terms["contrast_x"] = weights.contrast_x * mean_over_taps(hard, *vectors)
        if weights.relation:
            relation = mean_over_taps(semantic_relation, *vectors)
            terms["relation"] = weights.relation * relation
        if weights.contrast_y:
            same_y = self._patch_vectors(y, generate(self.generator, y))
            terms["contrast_y"] = weights.contrast_y * mean_over_taps(hard, *same_y)
        return terms
