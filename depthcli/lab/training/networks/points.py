"""Known points beside a predicted map: their differences, and a learned interpolation of them."""

import math
from typing import Any

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.lab.training.losses import full_precision

LEAST = 1e-6
GAIN = 10.0  #: of differences of coded depth, which are small, to the scale of other features
FOLLOWED = 3.0  #: logit of the share of what points say that is followed at first
HEADS = 2  # of the interpolation
_KEY_CHANNELS = 16
_DISTANCES = (0.3, 0.08)  # standard deviations of the heads at first, in widths
_NOTHING = -2.5  # logit of no correction at first
_NO_TRUST, _LEAST_BELIEF = 1e-9, 1e-3  # weights of cells without points, and with wrong ones
_SPREAD, _ERROR_SPREAD = 0.3, 0.15  # of points around their mean and around others, at first
_SELF = -1e4  # logit of a cell for itself, where it is left out
_LEAST_LOGIT = -60.0  # of less, softmax makes denormal numbers, which take CPUs ten times as long
_CENTRE_STEPS, _CENTRE_SD = 4, 0.15
_NEAREST = -1e4  # of a cell without points, among which the farthest is sought


class Points:
    """Known minus predicted depth, of the four pixels in each cell of stride 2.

    Attributes:
        known: (B, 4, H/2, W/2) float, 1 where depth is known.
        share: (B, 1, H/2, W/2) of pixels where it is known.
        centre: (B, 1, 1, 1), robust mean of all differences, coded.
        mean: (B, 1, H/2, W/2), that of the cell, less the centre, times GAIN.
        difference: (B, 4, H/2, W/2) less the centre, times GAIN; 0 where depth is unknown.
    """

    def __init__(self, prompt: Tensor, mask: Tensor, predicted: Tensor) -> None:
        """Compare coded depth of pixels, (B, 4, H/2, W/2)."""
        self.known, self.share = mask, _pixel_mean(mask)
        difference = (prompt - predicted) * mask
        mean = _pixel_mean(difference) / (self.share + LEAST)
        self.centre = robust_mean(mean, self.share)
        self.mean = GAIN * (mean - self.centre)
        self.difference = GAIN * (difference - self.centre * mask)

    def pooled(self, rest: Tensor, log_spread: Tensor, stride: int) -> tuple[Tensor, Tensor]:
        """Share of pixels with points, and the mean of ``rest``, in cells (B, 1, h, w) of a stride.

        ``rest`` is what a coarser field leaves of :attr:`mean`; values far from 0 count less.
        """
        weight = _cauchy(self.share, rest, GAIN * log_spread.exp())
        share, total = (pooled(values, stride // 2) for values in (weight, weight * rest))
        return share, total / (share + LEAST)

    def beyond_farthest(self, predicted: Tensor) -> Tensor:
        """Predicted (B, 1, H/2, W/2) less farthest known depth, of cells of stride 16; times GAIN.

        Sensors see nothing beyond their range: what looks as far as that is often farther.
        """
        farthest = GAIN * predicted + self.mean
        share, total = (pooled(values, 8) for values in (self.share, self.share * farthest))
        farthest = torch.where(share > 0, total / (share + LEAST), _NEAREST)
        return GAIN * predicted - farthest.amax((2, 3), keepdim=True)


class PointInterpolation(nn.Module):
    """Interpolation of what points say, each weighted by its distance and by learned likeness.

    Cells of stride 16 attend to those with points, by features at those. A point that contradicts
    the others, as they interpolate it, counts less.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        width = HEADS * _KEY_CHANNELS
        self.queries, self.keys = nn.Conv2d(channels, width, 1), nn.Conv2d(channels, width, 1)
        self.log_distance = nn.Parameter(torch.tensor(_DISTANCES).log())
        self.nothing = nn.Parameter(torch.full((HEADS,), _NOTHING))  # logit of no correction
        self.log_spread = nn.Parameter(torch.tensor([_SPREAD, _ERROR_SPREAD]).log())
        self.belief = nn.Sequential(nn.Conv2d(4 + HEADS, 16, 1), nn.ReLU(), nn.Conv2d(16, 1, 1))
        nn.init.zeros_(self.belief[-1].weight)  # type: ignore[arg-type]
        nn.init.constant_(self.belief[-1].bias, FOLLOWED)  # type: ignore[arg-type]

    def forward(self, image_map: Tensor, points: Points) -> tuple[Tensor, Tensor, Tensor]:
        """The field (B, 1, h/2, w/2) of features (B, C, h, w), its parts, and what points are like.

        Parts are the field and the support of each head, (B, 2 heads, h/2, w/2); the last are the
        scatter and number of all points, (B, 2, 1, 1) about 1.
        """
        fine, _ = points.pooled(points.mean, self.log_spread[0], 8)
        count, mean = points.pooled(points.mean, self.log_spread[0], 16)
        size = mean.shape[2:]
        scaled = [each / math.sqrt(_KEY_CHANNELS) for each in self.queries.parameters()]
        weight, bias = map(torch.cat, zip(scaled, self.keys.parameters(), strict=True))
        features = F.conv2d(image_map, weight, bias).float()  # one convolution is faster than two
        local = pooled(features * fine, 2) / (pooled(fine, 2) + LEAST)
        ones = torch.ones_like(mean)  # column and row of each cell, in widths of the map
        places = (torch.cat([ones.cumsum(3), ones.cumsum(2)], 1) - 0.5) / ones.sum(3, keepdim=True)
        cells = torch.cat([local, pooled(features, 2), count, mean, places], 1).flatten(2)
        local, keys, queries, _, count, mean, places = cells.split_with_sizes(
            [HEADS * _KEY_CHANNELS] * 4 + [1, 1, 2], 1
        )
        number = count * 16**2
        trust = (number + _NO_TRUST).log().clamp(max=1.0)
        itself = _SELF * torch.eye(cells.shape[2], cells.shape[2] + 1, device=cells.device)
        error, _, supports = self._taken(local, keys, places, trust, mean, itself)
        error = error.abs()
        total = count.sum(2, keepdim=True)
        scatter = (count * error).sum(2, keepdim=True) / (total + LEAST)
        facts = [(scatter / GAIN + 1e-3).log() / 2 + 1.5, (total + 1e-3).log() / 4]
        evidence = torch.cat([error, scatter.expand_as(error), mean, number, supports], 1)
        belief = self.belief(evidence[:, :, None])[:, :, 0].float().sigmoid()
        belief = _cauchy(belief, error, GAIN * self.log_spread[1].exp())
        trust = trust + (belief + _LEAST_BELIEF).log()
        left, taken, supports = self._taken(queries, keys, places, trust, mean)
        cells = torch.cat([mean - left, taken, supports], 1).unflatten(2, size)  # type: ignore[no-untyped-call]
        field, heads = cells.split_with_sizes([1, 2 * HEADS], 1)
        return field, heads, torch.cat(facts, 1)[..., None]

    def _taken(
        self,
        queries: Tensor,
        keys: Tensor,
        places: Tensor,
        trust: Tensor,
        mean: Tensor,
        bias: Tensor | float = 0.0,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """What the heads leave of the mean (B, 1, N), one after another, take, and their support.

        Of queries and keys (B, heads · channels, N), columns and rows (B, 2, N), logits ``trust``
        (B, 1, N) and ``bias`` (N, N + 1), whose last key is no correction.
        """
        ones, left, taken = torch.ones_like(mean), mean, []
        heads = [_KEY_CHANNELS] * HEADS
        pairs = zip(*(each.split_with_sizes(heads, 1) for each in (queries, keys)), strict=True)
        with full_precision(mean):
            for head, (query, key) in enumerate(pairs):
                at = places / self.log_distance[head].exp()
                far = (at * at).sum(1, keepdim=True) / 2
                last = trust + (-far - self.nothing[head])
                to = torch.cat([query, at, -far, ones], 1).transpose(1, 2)
                of = F.pad(torch.cat([key, at, ones, last], 1), (0, 1))
                shares = (to @ of + bias).clamp(min=_LEAST_LOGIT).softmax(2)
                values = F.pad(torch.cat([left, ones], 1), (0, 1))
                taken.append((values @ shares.transpose(1, 2)).split_with_sizes([1, 1], 1))
                left = left - taken[-1][0]
        parts, supports = (torch.cat(each, 1) for each in zip(*taken, strict=True))
        return left, parts, supports


def robust_mean(values: Tensor, weights: Tensor) -> Tensor:
    """Mean (B, 1, 1, 1) of values (B, 1, H, W), reweighted by Cauchy; 0 without any weight."""
    weight, mean = weights, torch.zeros_like(weights[:, :, :1, :1])
    for _ in range(_CENTRE_STEPS):
        total = (weight * values).sum((2, 3), keepdim=True)
        mean = total / (weight.sum((2, 3), keepdim=True) + LEAST)
        weight = _cauchy(weights, values - mean, _CENTRE_SD)
    return mean


def _cauchy(weight: Tensor, rest: Tensor, spread: Tensor | float) -> Tensor:
    """Less weight of what is far from 0: weight / (1 + rest² / spread²)."""
    return weight * spread**2 / (spread**2 + rest * rest)


def _pixel_mean(pixels: Tensor) -> Tensor:
    """Mean of channels (B, 4, H, W); additions are faster than a mean in exported graphs."""
    first, *others = pixels.split_with_sizes([1] * 4, 1)
    return sum(others, first) / 4


def unpacked(values: Tensor, channels: int = 1) -> Tensor:
    """Pixels of cells of stride 2, as channels: of (B, C, H, W), (B, 4 C, H/2, W/2)."""
    if not torch.onnx.is_in_onnx_export():
        return F.pixel_unshuffle(values, 2)
    each = values.split_with_sizes([1] * channels, 1) if channels > 1 else (values,)
    return torch.cat([_Unpacked.apply(channel) for channel in each], 1)  # type: ignore[no-untyped-call]


class _Unpacked(torch.autograd.Function):
    """One operator in the exported graph, which torch's exporter does not use."""

    @staticmethod
    def forward(_: Any, x: Tensor) -> Tensor:  # noqa: ANN401
        return F.pixel_unshuffle(x, 2)

    @staticmethod
    def symbolic(graph: Any, x: Any) -> Any:  # noqa: ANN401
        return graph.op("SpaceToDepth", x, blocksize_i=2)


def pooled(values: Tensor, size: int) -> Tensor:
    """Mean over cells of ``size`` × ``size`` pixels, those at the end may be smaller."""
    if size == 1:
        return values
    return F.avg_pool2d(values, size, ceil_mode=True, count_include_pad=False)
