"""CycleGAN (Zhu et al. 2017): two generators, inverse to each other, and two discriminators."""

from typing import ClassVar, NamedTuple

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.training.config import TrainConfig
from depthcli.training.data import TrainingBatch
from depthcli.training.losses import discriminator_loss, generator_loss
from depthcli.training.methods.base import (
    Method,
    Phase,
    frozen,
    generate,
    present,
    required,
    upsampled_like,
)
from depthcli.training.networks.build import build_discriminator, build_generator


class ImagePool:
    """Stores the first images; then swaps each new one with a random stored one, with p = 0.5.

    With a size of 0, every image is returned unchanged. Images are swapped with others of their
    own size only.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.images: list[Tensor] = []

    def exchange(self, images: Tensor) -> Tensor:
        """New or past fakes (B, C, H, W), detached, for new ones (B, C, H, W)."""
        if self.size == 0:
            return images.detach()
        return torch.stack([self._exchange_one(image) for image in images.detach()])

    def _exchange_one(self, image: Tensor) -> Tensor:
        if len(self.images) < self.size:
            self.images.append(image.clone())
            return image
        if torch.rand(()) < 0.5:  # noqa: PLR2004
            return image
        alike = [i for i, past in enumerate(self.images) if past.shape == image.shape]
        if not alike:
            return image
        slot = alike[int(torch.randint(len(alike), ()))]
        past, self.images[slot] = self.images[slot], image.clone()
        return past


class GeneratorOutputs(NamedTuple):
    """The generators' outputs for a batch; None if no loss term needs it."""

    raw_y: Tensor  #: G(x) at the generator's output size
    fake_y: Tensor  #: G(x), (B, 1, H, W)
    fake_x: Tensor | None  #: F(y)
    same_y: Tensor | None  #: G(y)


class CycleGan(Method):
    """Eq. 2, 3, 5 and 6; a weight of zero leaves the term and its networks out.

    G maps gray to depth, F depth to gray; D_y judges depth, D_x gray.
    """

    TERMS: ClassVar = frozenset({"adversarial", "cycle", "identity"})
    phases: tuple[Phase, ...] = ("generator", "discriminator")

    def __init__(self, config: TrainConfig) -> None:
        super().__init__(config)
        self.backward_generator = build_generator(config.generator) if self._has_backward else None
        self.depth_discriminator = build_discriminator(config) if self.weights.adversarial else None
        self.gray_discriminator = (
            build_discriminator(config) if self._has_gray_discriminator else None
        )
        self.pools = (ImagePool(config.optim.pool_size), ImagePool(config.optim.pool_size))
        self._fake_y: Tensor | None = None
        self._fake_x: Tensor | None = None

    @property
    def _has_backward(self) -> bool:
        return bool(self.weights.cycle or self.weights.identity or self._has_gray_discriminator)

    @property
    def _has_gray_discriminator(self) -> bool:
        return bool(self.weights.adversarial and self.weights.adversarial_backward)

    def networks(self, phase: Phase) -> list[nn.Module]:
        """G and F; or the discriminators."""
        if phase == "generator":
            return present(self.generator, self.backward_generator)
        return present(self.depth_discriminator, self.gray_discriminator)

    def forward(self, batch: TrainingBatch, phase: Phase) -> dict[str, Tensor]:
        """The generators' terms, or the discriminators'."""
        x, y = batch.network_input, self.encode(batch.depth_m)
        if phase == "discriminator":
            return self._discriminator_terms(x, y)
        outputs = self._translate(x, y)
        self._fake_y = outputs.fake_y.detach()
        self._fake_x = None if outputs.fake_x is None else outputs.fake_x.detach()
        return self._terms(batch, y, outputs)

    def _translate(self, x: Tensor, y: Tensor) -> GeneratorOutputs:
        forward, backward, weights = self.generator, self.backward_generator, self.weights
        raw_y = forward(x).float()
        keeps_y = weights.identity or weights.contrast_y
        return GeneratorOutputs(
            raw_y=raw_y,
            fake_y=upsampled_like(raw_y, x),
            fake_x=generate(backward, y) if backward is not None else None,
            same_y=generate(forward, y) if keeps_y else None,
        )

    def _terms(
        self, batch: TrainingBatch, y: Tensor, outputs: GeneratorOutputs
    ) -> dict[str, Tensor]:
        """Weighted terms; y is the batch's depth, coded."""
        x, weights, terms = batch.network_input, self.weights, {}
        if weights.cycle:
            terms["cycle"] = weights.cycle * self._cycle(x, y, outputs)
        if weights.identity:
            terms["identity"] = weights.identity * self._identity(x, y, outputs)
        if weights.adversarial:
            terms["adversarial"] = weights.adversarial * self._adversarial(x, y, outputs)
        return terms

    def _cycle(self, x: Tensor, y: Tensor, outputs: GeneratorOutputs) -> Tensor:
        """Eq. 2."""
        there = F.l1_loss(generate(required(self.backward_generator), outputs.fake_y), x)
        return there + F.l1_loss(generate(self.generator, required(outputs.fake_x)), y)

    def _identity(self, x: Tensor, y: Tensor, outputs: GeneratorOutputs) -> Tensor:
        """Eq. 3."""
        same_x = generate(required(self.backward_generator), x)
        return F.l1_loss(required(outputs.same_y), y) + F.l1_loss(same_x, x)

    def _adversarial(self, x: Tensor, y: Tensor, outputs: GeneratorOutputs) -> Tensor:
        """The generators' half of eq. 5 and 6."""
        gan, d_y, d_x = (
            self.weights.gan,
            required(self.depth_discriminator),
            self.gray_discriminator,
        )
        with frozen(present(d_y, d_x)):
            loss = generator_loss(gan, d_y, real=y, fake=outputs.fake_y)
            if d_x is not None:
                loss = loss + generator_loss(gan, d_x, real=x, fake=required(outputs.fake_x))
        return loss

    def _discriminator_terms(self, x: Tensor, y: Tensor) -> dict[str, Tensor]:
        """The discriminators' half of eq. 5 and 6, on pooled fakes."""
        gan, terms = self.weights.gan, {}
        if self.gray_discriminator is not None and self._fake_x is not None:
            past_x = self.pools[0].exchange(self._fake_x)
            terms["gray_discriminator"] = discriminator_loss(
                gan, self.gray_discriminator, real=x, fake=past_x
            )
        if self.depth_discriminator is not None and self._fake_y is not None:
            past_y = self.pools[1].exchange(self._fake_y)
            terms["depth_discriminator"] = discriminator_loss(
                gan, self.depth_discriminator, real=y, fake=past_y
            )
        return terms

    def extra_state(self) -> dict[str, list[Tensor]]:
        """The image pools."""
        return {"pool_gray": self.pools[0].images, "pool_depth": self.pools[1].images}

    def load_extra_state(self, state: dict[str, list[Tensor]]) -> None:
        """Refill the image pools."""
        self.pools[0].images = list(state["pool_gray"])
        self.pools[1].images = list(state["pool_depth"])
