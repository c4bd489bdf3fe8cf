"""A network that follows known depth: a trained one, and a decoder that corrects its output."""

from collections.abc import Sequence
from typing import Self

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.core.types import DepthCodec
from depthcli.training.networks.efficient import ConvNorm, DecodingGenerator

STRIDES = (32, 16, 8, 4, 2)
_CENTRE_STEPS = 4
_CENTRE_SD = 0.15  # of the difference between known and predicted depth, in coded depth
_SPREADS = (0.3, 0.2, 0.15, 0.1, 0.1)  # of the same around the coarser field, at first
_LEAST = 1e-6
_PRIOR = 0.05  # weight of no correction beside cells with points
_FOLLOWED = 2.0  # logit of the share of what points say that is followed at first


class PromptedGenerator(nn.Module):
    """Network input and known depth to raw depth at half the input's size.

    The difference between known and predicted depth is pooled over cells of the decoder's strides
    and, from coarse to fine, spread over the map: at first as it is, and as far as training of
    the layers in between shows. Only differences of coded depth are used, which is a logarithm:
    known depth multiplied by a number multiplies the output by it. Without known depth, the output
    is exactly that of the trained network, whose weights do not change.

    Args:
        base: the trained network.
        widths: channels of the added layers at strides 32, 16, 8, 4, 2.
    """

    def __init__(self, base: DecodingGenerator, widths: Sequence[int]) -> None:
        super().__init__()
        self.channels = int(getattr(base, "channels", 1))
        self.base = base.requires_grad_(False).eval()
        inner = (base.encoder_channels[-1], *base.decoder_channels)
        self.correction = nn.ModuleList(
            CorrectionLevel(seen, below, width, stride=stride, spread=spread)
            for seen, below, width, stride, spread in zip(
                inner, (0, *widths), widths, STRIDES, _SPREADS, strict=False
            )
        )

    def train(self, mode: bool = True) -> Self:
        """Set the mode of the added layers; the trained network stays in evaluation mode."""
        super().train(mode)
        self.base.eval()
        return self

    def forward(
        self, image: Tensor, prompt: Tensor | None = None, mask: Tensor | None = None
    ) -> Tensor:
        """Raw depth (B, 1, ceil(H/2), ceil(W/2)).

        Args:
            image: (B, C, H, W) in [-1, 1].
            prompt: (B, 1, H, W) known depth, coded as the output; anything where it is unknown.
            mask: (B, 1, H, W) float, 1 where depth is known and 0 elsewhere.
        """
        with torch.no_grad():
            maps = self.base.decoded(image)
            raw: Tensor = self.base.head(maps[-1]).float()
        if prompt is None or mask is None:
            return raw
        difference = (prompt - _resized(raw, prompt)) * mask
        centre = robust_mean(difference, mask)
        difference = (difference - centre) * mask
        field, features = torch.zeros_like(maps[0][:, :1]).float(), None
        for level, seen in zip(self.correction, maps, strict=True):
            field, features = level(seen, features, field, difference, mask)
        is_prompted = (mask.amax((1, 2, 3), keepdim=True) > 0).float()
        made: Tensor = raw + is_prompted * (centre + field)
        return made


class CorrectionLevel(nn.Module):
    """One stride of the correction.

    Args:
        seen: channels of the trained network's feature map.
        below: channels of the features of the coarser level; 0 for the coarsest.
        width: channels of the own features.
        stride: of the feature map.
        spread: standard deviation of differences that are believed, at first.
    """

    blur: Tensor

    def __init__(self, seen: int, below: int, width: int, *, stride: int, spread: float) -> None:
        super().__init__()
        self.stride = stride
        self.log_spread = nn.Parameter(torch.tensor(spread).log())
        self.log_stiffness = nn.Parameter(torch.tensor(0.3).log())
        self.features = nn.Sequential(
            ConvNorm(seen + below + 4, width, norm=False), ConvNorm(width, width, norm=False)
        )
        self.head = nn.Conv2d(width, 2, 3, padding=1)
        nn.init.zeros_(self.head.weight)
        with torch.no_grad():
            self.head.bias.copy_(torch.tensor([_FOLLOWED, 0.0]))  # type: ignore[union-attr]
        blur = torch.tensor([1.0, 2.0, 1.0]) / 4
        self.register_buffer("blur", (blur[:, None] * blur).view(1, 1, 3, 3), persistent=False)

    def forward(
        self, seen: Tensor, below: Tensor | None, field: Tensor, difference: Tensor, mask: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The finer field of corrections (B, 1, h, w), and features (B, width, h, w).

        Args:
            seen: (B, seen, h, w), the trained network's features.
            below: (B, below, h', w'), the features of the coarser level.
            field: (B, 1, h', w'), the field of the coarser level.
            difference: (B, 1, H, W), known minus predicted coded depth; 0 where it is unknown.
            mask: (B, 1, H, W), where it is known.
        """
        rest = difference - _resized(field, difference)
        weight = mask / (1 + (rest / self.log_spread.exp()) ** 2)
        count = self._pooled(weight)
        mean = self._pooled(weight * rest) / (count + _LEAST)
        trust = count / (count + self.log_stiffness.exp() / self.stride**2)
        near = F.conv2d(trust, self.blur, padding=1)
        spread = F.conv2d(trust * mean, self.blur, padding=1) / (near + _PRIOR)
        field = _resized(field, seen)
        coarser = [] if below is None else [_resized(below, seen)]
        features = self.features(
            torch.cat([seen, *coarser, trust, mean, near, spread.clamp(-1, 1)], 1)
        )
        followed, added = self.head(features).float().chunk(2, 1)
        return field + followed.sigmoid() * spread + added, features

    def _pooled(self, values: Tensor) -> Tensor:
        return F.avg_pool2d(values, self.stride, ceil_mode=True, count_include_pad=False)


def robust_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Mean of the values (B, 1, H, W) where the mask is 1, with less weight of those far from it.

    By reweighting with Cauchy's weights; (B, 1, 1, 1), 0 where the mask is 0 everywhere.
    """
    weight, mean = mask, torch.zeros_like(mask[:, :, :1, :1])
    for _ in range(_CENTRE_STEPS):
        total = (weight * values).sum((2, 3), keepdim=True)
        mean = total / (weight.sum((2, 3), keepdim=True) + _LEAST)
        weight = mask / (1 + ((values - mean) / _CENTRE_SD) ** 2)
    return mean


def _resized(values: Tensor, like: Tensor) -> Tensor:
    return F.interpolate(values, size=like.shape[2:], mode="bilinear", align_corners=False)


def coded_prompt(prompt_m: Tensor, codec: DepthCodec) -> tuple[Tensor, Tensor]:
    """Known depth as the network takes it: coded, and its mask; both (B, 1, H, W) float.

    Args:
        prompt_m: (B, 1, H, W) metres, 0 where nothing is known.
        codec: of logarithmic depth.
    """
    known = prompt_m > 0
    coded = (torch.where(known, prompt_m, 1.0).log() - codec.shift) / codec.scale
    return coded * known, known.float()
