"""CycleGAN (Zhu et al. 2017): two generators that undo each other, two discriminators."""

from typing import ClassVar, NamedTuple

import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.training.config.schema import TrainConfig
from depthcli.training.data.batches import TrainingBatch
from depthcli.training.image_pool import ImagePool
from depthcli.training.losses.adversarial import discriminator_loss, generator_loss
from depthcli.training.methods.base import (
    Method,
    Phase,
    frozen,
    not_none,
    present,
    sized,
    translated,
)
from depthcli.training.networks.build import build_discriminator, build_generator


class Made(NamedTuple):
    """What the generators make of a batch; None where no term asks for it."""

    raw_y: Tensor  #: G(x) at the generator's own size
    fake_y: Tensor  #: G(x), (B, 1, H, W)
    fake_x: Tensor | None  #: F(y)
    same_y: Tensor | None  #: G(y)


class CycleGan(Method):
    """Eq. 2, 3, 5 and 6; a weight of zero leaves the term and its networks out.

    G maps gray to depth, F depth to gray; D_y judges depth, D_x gray.
    """

    TERMS: ClassVar = frozenset({"adversarial", "cycle", "identity"})
    SETTINGS: ClassVar = frozenset({"optim.pool_size"})
    phases: tuple[Phase, ...] = ("generator", "discriminator")

    def __init__(self, config: TrainConfig) -> None:
        super().__init__(config)
        self.backward_generator = build_generator(config.generator) if self._both_ways else None
        self.judge_depth = build_discriminator(config) if self.weights.adversarial else None
        self.judge_gray = build_discriminator(config) if self._judges_gray else None
        self.pools = (ImagePool(config.optim.pool_size), ImagePool(config.optim.pool_size))
        self._fake_y: Tensor | None = None
        self._fake_x: Tensor | None = None

    @property
    def _both_ways(self) -> bool:
        return bool(self.weights.cycle or self.weights.identity or self._judges_gray)

    @property
    def _judges_gray(self) -> bool:
        return bool(self.weights.adversarial and self.weights.adversarial_backward)

    def networks(self, phase: Phase) -> list[nn.Module]:
        """G and F; or the discriminators."""
        if phase == "generator":
            return not_none(self.generator, self.backward_generator)
        return not_none(self.judge_depth, self.judge_gray)

    def forward(self, batch: TrainingBatch, phase: Phase) -> dict[str, Tensor]:
        """The generators' terms, or the discriminators'."""
        x, y = batch.gray, self.encode(batch.depth_m)
        if phase == "discriminator":
            return self._judge(x, y)
        made = self._translate(x, y)
        self._fake_y = made.fake_y.detach()
        self._fake_x = None if made.fake_x is None else made.fake_x.detach()
        return self._terms(batch, y, made)

    def _translate(self, x: Tensor, y: Tensor) -> Made:
        forward, backward, weights = self.generator, self.backward_generator, self.weights
        raw_y = forward(x).float()
        keeps_y = weights.identity or weights.contrast_y
        return Made(
            raw_y=raw_y,
            fake_y=sized(raw_y, x),
            fake_x=translated(backward, y) if backward is not None else None,
            same_y=translated(forward, y) if keeps_y else None,
        )

    def _terms(self, batch: TrainingBatch, y: Tensor, made: Made) -> dict[str, Tensor]:
        """Weighted terms; y is the batch's depth, coded."""
        x, weights, terms = batch.gray, self.weights, {}
        if weights.cycle:
            terms["cycle"] = weights.cycle * self._cycle(x, y, made)
        if weights.identity:
            terms["identity"] = weights.identity * self._identity(x, y, made)
        if weights.adversarial:
            terms["adversarial"] = weights.adversarial * self._deceive(x, y, made)
        return terms

    def _cycle(self, x: Tensor, y: Tensor, made: Made) -> Tensor:
        """Eq. 2."""
        there = F.l1_loss(translated(present(self.backward_generator), made.fake_y), x)
        return there + F.l1_loss(translated(self.generator, present(made.fake_x)), y)

    def _identity(self, x: Tensor, y: Tensor, made: Made) -> Tensor:
        """Eq. 3."""
        same_x = translated(present(self.backward_generator), x)
        return F.l1_loss(present(made.same_y), y) + F.l1_loss(same_x, x)

    def _deceive(self, x: Tensor, y: Tensor, made: Made) -> Tensor:
        """The generators' half of eq. 5 and 6."""
        gan, judge_y, judge_x = self.weights.gan, present(self.judge_depth), self.judge_gray
        with frozen(not_none(judge_y, judge_x)):
            loss = generator_loss(gan, judge_y, real=y, fake=made.fake_y)
            if judge_x is not None:
                loss = loss + generator_loss(gan, judge_x, real=x, fake=present(made.fake_x))
        return loss

    def _judge(self, x: Tensor, y: Tensor) -> dict[str, Tensor]:
        """The discriminators' half of eq. 5 and 6, on pooled fakes."""
        gan, terms = self.weights.gan, {}
        if self.judge_gray is not None and self._fake_x is not None:
            past_x = self.pools[0].exchange(self._fake_x)
            terms["judge_gray"] = discriminator_loss(gan, self.judge_gray, real=x, fake=past_x)
        if self.judge_depth is not None and self._fake_y is not None:
            past_y = self.pools[1].exchange(self._fake_y)
            terms["judge_depth"] = discriminator_loss(gan, self.judge_depth, real=y, fake=past_y)
        return terms

    def extra_state(self) -> dict[str, list[Tensor]]:
        """The image pools."""
        return {"pool_gray": self.pools[0].images, "pool_depth": self.pools[1].images}

    def load_extra_state(self, state: dict[str, list[Tensor]]) -> None:
        """Refill the image pools."""
        self.pools[0].images = list(state["pool_gray"])
        self.pools[1].images = list(state["pool_depth"])
