"""The paper's method (eq. 7): CycleGAN with contrast and a regularised L1 on paired depth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
import torch.nn.functional as F  # noqa: N812
from torch import nn

from depthcli.training.image_pool import ImagePool
from depthcli.training.losses.adversarial import discriminator_loss, generator_loss
from depthcli.training.losses.gradient import gradient_loss
from depthcli.training.losses.patchnce import cfl_nce, patch_nce
from depthcli.training.losses.regularised_l1 import regularised_l1
from depthcli.training.methods.base import Method, Phase
from depthcli.training.networks.build import build_generator
from depthcli.training.networks.patch_sampler import PatchSampler
from depthcli.training.networks.patchgan import PatchGan

if TYPE_CHECKING:
    from torch import Tensor

    from depthcli.training.batches import Batch
    from depthcli.training.config import TrainConfig
    from depthcli.training.networks.efficient import EfficientGenerator
    from depthcli.training.networks.resnet import ResnetGenerator


class Proposed(Method):
    """Eq. 7, and any part of it: a weight of zero leaves the term and its networks out.

    G maps gray to depth, F depth to gray; D_y judges depth, D_x gray.
    """

    phases: tuple[Phase, ...] = ("generator", "discriminator")

    def __init__(self, config: TrainConfig) -> None:
        super().__init__(config)
        self.weights = config.loss
        self.codec = config.output.codec
        self.generator: EfficientGenerator | ResnetGenerator = build_generator(config.generator)
        self.both_ways = bool(self.weights.cycle or self.weights.adversarial)
        self.both_ways |= bool(self.weights.identity or self.weights.l1_backward)
        self.backward_generator = build_generator(config.generator) if self.both_ways else None
        self.sampler = self._sampler() if self._contrast else None
        self.judge_depth, self.judge_gray = self._judges()
        self.pools = (ImagePool(config.optim.pool_size), ImagePool(config.optim.pool_size))
        self._fakes: tuple[Tensor, Tensor] | None = None

    @property
    def _contrast(self) -> bool:
        return bool(self.weights.contrast_x or self.weights.contrast_y)

    def _sampler(self) -> PatchSampler:
        taps = self.generator.TAPS
        return PatchSampler([self.generator.tap_channels(tap) for tap in taps])

    def _judges(self) -> tuple[PatchGan | None, PatchGan | None]:
        if not self.weights.adversarial:
            return None, None
        width = self.config.optim.width_discriminator
        return PatchGan(width=width), PatchGan(width=width)

    def networks(self, phase: Phase) -> list[nn.Module]:
        """G, F and the patch heads; or the discriminators."""
        makers = (self.generator, self.backward_generator, self.sampler)
        judges = (self.judge_depth, self.judge_gray)
        return [net for net in (makers if phase == "generator" else judges) if net is not None]

    def forward(self, batch: Batch, phase: Phase) -> dict[str, Tensor]:
        """Weighted terms of eq. 7, or of eq. 5 and 6 for the discriminators."""
        if phase == "discriminator":
            return self._judge(batch)
        x, y = batch.gray, self._encode(batch.depth_m)
        raw_y = self.generator(x).float()
        terms = self._supervised(raw_y, y)
        fake_y = _sized(raw_y, x)
        if self.backward_generator is not None:
            fake_x = _sized(self.backward_generator(y).float(), x)
            terms |= self._cyclic(x, y, fake_x, fake_y) | self._deceive(x, y, fake_x, fake_y)
            if self.weights.l1_backward:
                penalty = self.weights.weight_penalty
                l1 = regularised_l1(fake_x, x, self.backward_generator, penalty)
                terms["l1_backward"] = self.weights.l1 * l1
            self._fakes = fake_x.detach(), fake_y.detach()
        if self._contrast:
            terms |= self._contrasted(x, y, fake_y)
        return terms

    def _encode(self, depth_m: Tensor) -> Tensor:
        """Metres to the networks' coding, (B, 1, H, W) in [-1, 1]."""
        depth_m = depth_m.clamp(self._nearest_m, self.config.output.max_m)
        t = torch.log(depth_m) if self.config.output.coding == "log" else depth_m
        return (t - self.codec.shift) / self.codec.scale

    @property
    def _nearest_m(self) -> float:
        return self.config.output.min_m if self.config.output.coding == "log" else 0.0

    def _supervised(self, raw_y: Tensor, y: Tensor) -> dict[str, Tensor]:
        weights, terms = self.weights, {}
        truth = F.interpolate(y, size=raw_y.shape[2:], mode="area") if _smaller(raw_y, y) else y
        if weights.l1:
            l1 = regularised_l1(raw_y, truth, self.generator, weights.weight_penalty)
            terms["l1"] = weights.l1 * l1
        if weights.gradient:
            terms["gradient"] = weights.gradient * gradient_loss(raw_y, truth)
        return terms

    def _cyclic(self, x: Tensor, y: Tensor, fake_x: Tensor, fake_y: Tensor) -> dict[str, Tensor]:
        """Eq. 2 and eq. 3."""
        forward, backward, terms = self.generator, self.backward_generator, {}
        assert backward is not None  # noqa: S101 - for the type checker
        if self.weights.cycle:
            there = F.l1_loss(_sized(backward(fake_y).float(), x), x)
            back = F.l1_loss(_sized(forward(fake_x).float(), y), y)
            terms["cycle"] = self.weights.cycle * (there + back)
        if self.weights.identity:
            same_y = F.l1_loss(_sized(forward(y).float(), y), y)
            same_x = F.l1_loss(_sized(backward(x).float(), x), x)
            terms["identity"] = self.weights.identity * (same_y + same_x)
        return terms

    def _deceive(self, x: Tensor, y: Tensor, fake_x: Tensor, fake_y: Tensor) -> dict[str, Tensor]:
        """The generators' half of eq. 5 and 6."""
        if self.judge_depth is None or self.judge_gray is None:
            return {}
        gan = self.weights.gan
        _freeze(self.networks("discriminator"), frozen=True)
        loss_y = generator_loss(gan, self.judge_depth, real=y, fake=fake_y)
        loss_x = generator_loss(gan, self.judge_gray, real=x, fake=fake_x)
        _freeze(self.networks("discriminator"), frozen=False)
        return {"adversarial": self.weights.adversarial * (loss_y + loss_x)}

    def _judge(self, batch: Batch) -> dict[str, Tensor]:
        """The discriminators' half of eq. 5 and 6, on pooled fakes."""
        if self.judge_depth is None or self.judge_gray is None or self._fakes is None:
            return {}
        gan, (fake_x, fake_y) = self.weights.gan, self._fakes
        x, y = batch.gray, self._encode(batch.depth_m)
        past_x, past_y = self.pools[0].exchange(fake_x), self.pools[1].exchange(fake_y)
        return {
            "judge_depth": discriminator_loss(gan, self.judge_depth, real=y, fake=past_y),
            "judge_gray": discriminator_loss(gan, self.judge_gray, real=x, fake=past_x),
        }

    def _contrasted(self, x: Tensor, y: Tensor, fake_y: Tensor) -> dict[str, Tensor]:
        """Eq. 4: features of the output against those of the input, or of the paired truth."""
        terms = {}
        if self.weights.contrast_x:
            loss = self._cfl(y, fake_y) if self.weights.contrast == "cfl" else self._nce(x, fake_y)
            terms["contrast_x"] = self.weights.contrast_x * loss
        if self.weights.contrast_y:
            same_y = _sized(self.generator(y).float(), y)
            terms["contrast_y"] = self.weights.contrast_y * self._nce(y, same_y)
        return terms

    def _nce(self, source: Tensor, output: Tensor) -> Tensor:
        queries, keys = self._projected(output, source)
        return torch.stack([patch_nce(q, k) for q, k in zip(queries, keys, strict=True)]).mean()

    def _cfl(self, truth: Tensor, output: Tensor) -> Tensor:
        queries, keys = self._projected(output, truth)
        return torch.stack([cfl_nce(q, k) for q, k in zip(queries, keys, strict=True)]).mean()

    def _projected(self, output: Tensor, source: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        assert self.sampler is not None  # noqa: S101 - for the type checker
        keys, positions = self.sampler(self.generator.features(source), None)
        queries, _ = self.sampler(self.generator.features(output), positions)
        return queries, keys

    def extra_state(self) -> dict[str, list[Tensor]]:
        """The image pools."""
        return {"pool_gray": self.pools[0].images, "pool_depth": self.pools[1].images}

    def load_extra_state(self, state: dict[str, list[Tensor]]) -> None:
        """Refill the image pools."""
        self.pools[0].images = list(state["pool_gray"])
        self.pools[1].images = list(state["pool_depth"])


def _smaller(image: Tensor, other: Tensor) -> bool:
    return image.shape[2:] != other.shape[2:]


def _sized(image: Tensor, like: Tensor) -> Tensor:
    """Grow an output at a lower stride to the size of an input."""
    if not _smaller(image, like):
        return image
    return F.interpolate(image, size=like.shape[2:], mode="bilinear", align_corners=False)


def _freeze(networks: list[nn.Module], *, frozen: bool) -> None:
    for network in networks:
        network.requires_grad_(not frozen)
