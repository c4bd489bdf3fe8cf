"""CycleGAN (Zhu et al. 2017): two inverse generators, two discriminators, and image pools."""

from typing import ClassVar, NamedTuple

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

from depthcli.lab.training.config import TrainConfig
from depthcli.lab.training.data import TrainingBatch
from depthcli.lab.training.methods.base import Phase, TwoWay, generate, required, upsampled_like


class ImagePool:
    """Stores the first images; then swaps each new one with a random stored one, with p = 0.5.

    It swaps images of one size only; with a size of 0, it returns every image unchanged.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.images: list[Tensor] = []

    def exchange(self, images: Tensor) -> Tensor:
        """New or past fakes (B, C, H, W), detached, for new ones (B, C, H, W)."""
        images = images.detach()
        return torch.stack(list(map(self._exchange_one, images))) if self.size else images

    def _exchange_one(self, image: Tensor) -> Tensor:
        if len(self.images) < self.size:
            self.images.append(image.clone())
            return image
        alike = [i for i, past in enumerate(self.images) if past.shape == image.shape]
        if torch.rand(()) < 0.5 or not alike:  # noqa: PLR2004
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


class CycleGan(TwoWay):
    """Eq. 2, 3, 5 and 6; a weight of zero leaves the term and its networks out."""

    TERMS: ClassVar = frozenset({"adversarial", "cycle", "identity"})
    phases: tuple[Phase, ...] = ("generator", "discriminator")

    def __init__(self, config: TrainConfig, *, backward: bool = False) -> None:
        weights = config.loss
        judges_gray = bool(weights.adversarial and weights.adversarial_backward)
        needed = bool(weights.cycle or weights.identity or judges_gray)
        super().__init__(config, backward=backward or needed, gray_discriminator=judges_gray)
        self.pools = (ImagePool(config.optim.pool_size), ImagePool(config.optim.pool_size))
        self._fakes: tuple[Tensor | None, Tensor] | None = None

    def forward(self, batch: TrainingBatch, phase: Phase) -> dict[str, Tensor]:
        """The generators' terms, or the discriminators', on pooled fakes of the phase before."""
        x, y = batch.network_input, self.encode(batch.depth_m)
        if phase == "generator":
            outputs = self._translate(x, y)
            fake_x = outputs.fake_x
            self._fakes = (None if fake_x is None else fake_x.detach(), outputs.fake_y.detach())
            return self._terms(batch, y, outputs)
        if self._fakes is None:
            return {}
        fake_x, fake_y = self._fakes
        if self.gray_discriminator is not None and fake_x is not None:
            fake_x = self.pools[0].exchange(fake_x)
        return self.discriminator_terms(x, y, fake_x, self.pools[1].exchange(fake_y))

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
        x = batch.network_input

        def cycle() -> Tensor:  # eq. 2
            there = F.l1_loss(generate(required(self.backward_generator), outputs.fake_y), x)
            return there + F.l1_loss(generate(self.generator, required(outputs.fake_x)), y)

        terms = self.weighted(cycle=cycle) | self.identity_terms(x, y, outputs.same_y)
        return terms | self.adversarial_terms(x, y, outputs.fake_x, outputs.fake_y)

    def extra_state(self) -> dict[str, list[Tensor]]:
        """The image pools."""
        return {"pool_gray": self.pools[0].images, "pool_depth": self.pools[1].images}

    def load_extra_state(self, state: dict[str, list[Tensor]]) -> None:
        """Refill the image pools."""
        self.pools[0].images = list(state["pool_gray"])
        self.pools[1].images = list(state["pool_depth"])
