"""A network that follows known depth: a trained one, and layers that correct its output."""

from collections.abc import Sequence
from typing import Self

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.core.types import DepthCodec
from depthcli.lab.training.losses import full_precision
from depthcli.lab.training.networks.efficient import ConvNorm, DecodingGenerator, resized
from depthcli.lab.training.networks.points import (
    FOLLOWED,
    GAIN,
    HEADS,
    PointInterpolation,
    Points,
    pooled,
    unpacked,
)

_COARSEST = 16  # stride of the interpolation
_CONVOLUTIONS = (2, 2, 1, 1)  # at strides 16, 8, 4 and 2
# Of known depth around the coarser field, at first, in coded depth.
_SPREADS = (0.2, 0.15, 0.1, 0.1)
_PRIOR = 0.05  # weight of no correction beside cells with points
_STIFFNESS = 0.3  # that in a cell, in points, at first
_ENCODER_SCALE = 8.0  # of maps of encoders without a nonlinearity at their end, about
_BELOW = 8  # channels of what a level takes of the coarser one
_MULTIPLE = 8  # of the channels of a convolution; int8 ones of others take twice as long
_LARGEST = 5.0  # of features of points
_LARGEST_LOGIT = 6.0  # of a pixel's weight


class PromptedGenerator(nn.Module):
    """Network input and known depth to raw depth at the input's size.

    Known minus predicted depth is first interpolated between all points, then corrected at strides
    16, 8, 4 and 2, and the map is enlarged along learned edges. Depth is coded as a logarithm:
    known depth multiplied by a number multiplies the output by it. Without known depth, the output
    is that of the trained network ``base``, whose weights do not change. ``widths`` are the
    channels of the added layers at these strides.
    """

    def __init__(self, base: DecodingGenerator, widths: Sequence[int]) -> None:
        super().__init__()
        self.channels = int(getattr(base, "channels", 1))
        self.base = base.requires_grad_(False).eval()
        self.correction = Correction(base, widths)

    def train(self, mode: bool = True) -> Self:
        """Set the mode of the added layers; the trained network stays in evaluation mode."""
        super().train(mode)
        self.base.eval()
        return self

    def forward(
        self, image: Tensor, prompt: Tensor | None = None, mask: Tensor | None = None
    ) -> Tensor:
        """Raw depth (B, 1, H, W), or (B, 1, H/2, W/2) without a prompt.

        Of an image (B, C, H, W) in [-1, 1] of even size, known depth ``prompt`` (B, 1, H, W), coded
        as the output, and its mask, a float that is 1 where depth is known and 0 elsewhere.
        """
        maps, raw = self.plain(image)
        if prompt is None or mask is None:
            return raw
        return self.correction(image, maps, raw, prompt, mask)  # type: ignore[no-any-return]

    @torch.no_grad()
    def plain(self, image: Tensor) -> tuple[list[list[Tensor]], Tensor]:
        """Feature maps at strides 16, 8, 4, 2, and raw depth (B, 1, H/2, W/2) of the base."""
        skips, maps = self.base.maps(image)
        pairs = zip(maps[1:], reversed(skips), strict=True)
        levels = [[features for features in pair if features is not None] for pair in pairs]
        return levels, self.base.head(maps[-1]).float()


class Correction(nn.Module):
    """Layers that correct raw depth by known depth; the arguments are those of the generator."""

    def __init__(self, base: DecodingGenerator, widths: Sequence[int]) -> None:
        super().__init__()
        self.channels = int(getattr(base, "channels", 1))
        self.interpolation = PointInterpolation(base.decoder_channels[1])
        channels = zip(base.decoder_channels, reversed(base.encoder_channels[:-1]), strict=True)
        below = (2 * HEADS, *widths)
        extra = (0, 0, 0, 8 + 4 * self.channels)  # of single pixels
        self.levels = nn.ModuleList(map(CorrectionLevel, channels, below, extra, widths, range(4)))
        self.enlarging = EdgeUpsampling(widths[-1])

    def forward(
        self, image: Tensor, maps: list[list[Tensor]], raw: Tensor, prompt: Tensor, mask: Tensor
    ) -> Tensor:
        """Raw depth (B, 1, H, W) that follows known depth, of what a generator's plain returned."""
        mask = unpacked(mask)
        points = Points(unpacked(prompt), mask, neighbours(raw, self.enlarging.bilinear))
        field, below, facts = self.interpolation(maps[1][0], points)
        beyond = points.beyond_farthest(raw)
        pixels = torch.cat([unpacked(image, self.channels).float(), mask], 1)
        for level, features in zip(self.levels, maps, strict=True):
            field, below = level(features, below, field, points, facts, beyond, pixels)
        is_prompted = (points.share.sum((2, 3), keepdim=True) > 0).float()
        raw = raw + is_prompted * (points.centre + field / GAIN)
        return self.enlarging(raw, below, is_prompted)  # type: ignore[no-any-return]


class CorrectionLevel(nn.Module):
    """One stride of the correction, 16 at level 0 to 2 at level 3, with features of ``width``.

    ``channels`` are those of the trained network's maps, 0 for none, ``below`` those of the coarser
    level, ``extra`` those of single pixels, at the finest level only.
    """

    def __init__(
        self, channels: Sequence[int], below: int, extra: int, width: int, level: int
    ) -> None:
        super().__init__()
        self.stride, self.is_finest = _COARSEST >> level, extra > 0
        self.log_spread = nn.Parameter(torch.tensor(_SPREADS[level]).log())
        self.log_stiffness = nn.Parameter(torch.tensor(_STIFFNESS).log())
        self.of_seen = nn.ModuleList(nn.Conv2d(count, width, 1) for count in channels if count)
        self.of_below = nn.Conv2d(below, _BELOW, 1)
        inputs = 8 + extra + _BELOW
        self.more = -inputs % _MULTIPLE  # of the first channel, to fill up
        self.of_known = nn.Conv2d(inputs + self.more, width, 3, padding=1)
        self.features = nn.Sequential(
            *(ConvNorm(width, width, norm=False) for _ in range(_CONVOLUTIONS[level]))
        )
        for conv in self.modules():
            if isinstance(conv, nn.Conv2d):
                nn.init.kaiming_normal_(conv.weight, nonlinearity="relu")
                nn.init.zeros_(conv.bias)  # type: ignore[arg-type]
        with torch.no_grad():
            for weight in self.of_seen[1:].parameters():
                weight.div_(_ENCODER_SCALE)
        self.head = nn.Conv2d(width, 2, 1)
        nn.init.zeros_(self.head.weight)
        with torch.no_grad():
            self.head.bias.copy_(torch.tensor([FOLLOWED, 0.0]))  # type: ignore[union-attr]

    def forward(
        self,
        maps: list[Tensor],
        below: Tensor,
        field: Tensor,
        points: Points,
        facts: Tensor,
        beyond: Tensor,
        pixels: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """The finer field of corrections (B, 1, h, w), and features (B, width, h, w).

        ``maps`` (B, channels, h, w) are the trained network's, ``below`` and ``field`` those of the
        coarser level, ``facts`` (B, 2, 1, 1) of all points, ``beyond`` (B, 1, H/2, W/2) predicted
        less farthest depth, ``pixels`` (B, extra, H/2, W/2) image and mask, at the finest level.
        """
        coarser = resized(field, points.mean)
        count, mean = points.pooled(points.mean - coarser, self.log_spread, self.stride)
        trust = count / (count + self.log_stiffness.exp() / self.stride**2)
        near, total = (F.avg_pool2d(v, 3, 1, 1) for v in (trust, trust * mean))
        spread = total / (near + _PRIOR)
        inputs = [trust, near, facts * torch.ones_like(mean)]
        inputs += [mean, spread, (mean - spread).abs() * trust]
        inputs.append(pooled(beyond + coarser, self.stride // 2))
        if self.is_finest:
            inputs += [pixels, points.difference - coarser * points.known]
        below = self.of_below(below)
        if self.stride < _COARSEST:
            below = resized(below, mean)
            field = coarser if self.is_finest else resized(field, mean)
        inputs += [below, *[trust] * self.more]
        x = self.of_known(torch.cat(inputs, 1).clamp(-_LARGEST, _LARGEST))
        for conv, values in zip(self.of_seen, maps, strict=True):
            x = x + conv(values)
        features = self.features(F.relu(x))
        # Transposed, which of 1 × 1 is the same, as exported ones take half the time.
        weight = self.head.weight.transpose(0, 1)
        outputs = F.conv_transpose2d(features, weight, self.head.bias).float()
        followed, added = outputs.split_with_sizes([1, 1], 1)
        return field + followed.sigmoid() * spread + added, features


class EdgeUpsampling(nn.Module):
    """Doubling of a map's size, bilinearly but for learned weights of the four nearest pixels."""

    near: Tensor
    pixels: Tensor
    bilinear: Tensor

    def __init__(self, width: int) -> None:
        super().__init__()
        self.head = nn.Conv2d(width, 16, 1)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)  # type: ignore[arg-type]
        near = torch.zeros(4, 4, 3, 3)  # the nearest, beside, above or below, across; new pixels
        for pixel, (y, x) in enumerate(((0, 0), (0, 2), (2, 0), (2, 2))):
            for corner, place in enumerate(((1, 1), (1, x), (y, 1), (y, x))):
                near[corner, pixel, place[0], place[1]] = 1
        self.register_buffer("near", near.view(16, 1, 3, 3), persistent=False)
        weights = torch.tensor([9.0, 3.0, 3.0, 1.0]).repeat_interleave(4).view(16, 1, 1, 1) / 16
        pixels = weights * torch.eye(4).repeat(4, 1).view(16, 1, 2, 2)
        self.register_buffer("pixels", pixels, persistent=False)
        bilinear = (weights * near.view(16, 1, 3, 3)).view(4, 4, 1, 3, 3).sum(0)
        self.register_buffer("bilinear", bilinear, persistent=False)

    def forward(self, values: Tensor, features: Tensor, is_learned: Tensor) -> Tensor:
        """Values (B, 1, h, w) at twice their size, by features (B, width, h, w).

        It is bilinear where ``is_learned`` (B, 1, 1, 1) is 0.
        """
        logits = self.head(features).float().clamp(-_LARGEST_LOGIT, _LARGEST_LOGIT)
        share = (logits * is_learned).exp()
        with full_precision(values):
            near = neighbours(values, self.near)
            total, weight = (
                F.conv_transpose2d(each, self.pixels, stride=2) for each in (share * near, share)
            )
        return total / weight


def neighbours(values: Tensor, kernels: Tensor) -> Tensor:
    """Sums of the 3 × 3 pixels around each of (B, 1, h, w), by kernels (C, 1, 3, 3)."""
    with full_precision(values):
        return F.conv2d(F.pad(values, (1, 1, 1, 1), mode="replicate"), kernels)


def coded_prompt(prompt_m: Tensor, codec: DepthCodec) -> tuple[Tensor, Tensor]:
    """Known depth (B, 1, H, W) in metres, 0 for none, as the network takes it: code and mask."""
    mask = prompt_m > 0
    coded = (torch.where(mask, prompt_m, 1.0).log() - codec.shift) / codec.scale
    return coded * mask, mask.float()
