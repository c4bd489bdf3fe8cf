"""Known points beside a predicted map: their differences, and a learned interpolation of them."""

import math

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.training.losses import full_precision

LEAST = 1e-6
GAIN = 10.0
"""Of differences of coded depth, which are small, to the scale of other features."""
FOLLOWED = 3.0
"""Logit of the share of what points say that is followed at first."""
HEADS = 2  # of the interpolation
_KEY_CHANNELS = 16
_DISTANCES = (0.3, 0.08)  # standard deviations of the heads at first, in widths
_NOTHING = -2.5  # logit of no correction at first
_NO_TRUST, _LEAST_BELIEF = 1e-9, 1e-3  # weights of cells without points, and with wrong ones
_SPREAD, _ERROR_SPREAD = 0.3, 0.15  # of points around their mean and around others, at first
_SELF = -1e4  # logit of a cell for itself, where it is left out
_LEAST_LOGIT = -60.0  # of less, softmax makes denormal numbers, which take CPUs ten times as long
_CENTRE_STEPS, _CENTRE_SD = 4, 0.15
_PIXELS = torch.eye(4).view(4, 1, 2, 2)


class Points:
    """Known minus predicted depth, of the four pixels in each cell of stride 2.

    Attributes:
        difference: (B, 4, H/2, W/2) coded, 0 where depth is unknown.
        known: (B, 4, H/2, W/2) float, 1 where it is known.
        share: (B, 1, H/2, W/2) of pixels where it is known.
        centre: (B, 1, 1, 1), robust mean of all differences.
        mean: (B, 1, H/2, W/2), that of the cell, less the centre.
    """

    def __init__(self, difference: Tensor, mask: Tensor) -> None:
        self.difference, self.known = unpacked(difference), unpacked(mask)
        self.share = F.avg_pool2d(mask, 2)
        mean = F.avg_pool2d(difference, 2) / (self.share + LEAST)
        self.centre = robust_mean(mean, self.share)
        self.mean = mean - self.centre

    def pooled(self, rest: Tensor, spread: Tensor, stride: int) -> tuple[Tensor, Tensor]:
        """Share of pixels with points, and mean, in cells (B, 1, h, w) of a stride.

        The mean is that of ``rest``, which a coarser field leaves of :attr:`mean`; what is far
        from 0, in units of the spread, counts less.
        """
        weight = self.share / (1 + (rest / spread) ** 2)
        share, total = (pooled(values, stride // 2) for values in (weight, weight * rest))
        return share, total / (share + LEAST)


class PointInterpolation(nn.Module):
    """Interpolation of what points say, each weighted by its distance and by learned likeness.

    Cells of stride 16 attend to those that have points, whose features are those of the cells of
    stride 8 with points. A point that contradicts the others, as they interpolate it, counts less.
    """

    def __init__(self, seen: int) -> None:
        super().__init__()
        width = HEADS * _KEY_CHANNELS
        self.queries, self.keys = nn.Conv2d(seen, width, 1), nn.Conv2d(seen, width, 1)
        self.log_distance = nn.Parameter(torch.tensor(_DISTANCES).log())
        self.nothing = nn.Parameter(torch.full((HEADS,), _NOTHING))  # logit of no correction
        self.log_spread = nn.Parameter(torch.tensor([_SPREAD, _ERROR_SPREAD]).log())
        self.belief = nn.Sequential(nn.Conv2d(4 + HEADS, 16, 1), nn.ReLU(), nn.Conv2d(16, 1, 1))
        nn.init.zeros_(self.belief[-1].weight)  # type: ignore[arg-type]
        nn.init.constant_(self.belief[-1].bias, FOLLOWED)  # type: ignore[arg-type]

    def forward(self, seen: Tensor, points: Points) -> tuple[Tensor, Tensor, Tensor]:
        """The field (B, 1, h/2, w/2) of seen (B, C, h, w), its parts, and what points are like.

        The parts are the field and the support of each head, (B, 2 heads, h/2, w/2). The last are
        the scatter of all points, from what others say, and their number, (B, 2, 1, 1) about 1.
        """
        spreads = self.log_spread.exp()
        fine, _ = points.pooled(points.mean, spreads[0], 8)
        count, mean = points.pooled(points.mean, spreads[0], 16)
        queries, keys = self.queries(seen).float(), self.keys(seen).float()
        own_queries, own_keys = (
            pooled(each * fine, 2) / (pooled(fine, 2) + LEAST) for each in (queries, keys)
        )
        trust = (count * 16**2 + _NO_TRUST).log().clamp(max=1.0)
        cells = mean.shape[2] * mean.shape[3]
        itself = F.pad(torch.eye(cells, device=seen.device), (0, 1)) * _SELF
        error, parts = self._taken(own_queries, own_keys, trust, mean, itself)
        error = error.abs()
        total = count.sum((2, 3), keepdim=True)
        scatter = (count * error).sum((2, 3), keepdim=True) / (total + LEAST)
        told = torch.cat([(scatter + 1e-3).log() / 2 + 1.5, (total + 1e-3).log() / 4], 1)
        known = [GAIN * error, GAIN * scatter.expand_as(error), GAIN * mean, count * 16**2]
        belief = self.belief(torch.cat([*known, parts[:, HEADS:]], 1)).float().sigmoid()
        belief = belief / (1 + (error / spreads[1]) ** 2)
        trust = trust + (belief + _LEAST_BELIEF).log()
        left, parts = self._taken(pooled(queries, 2), own_keys, trust, mean)
        parts = torch.cat([GAIN * parts[:, :HEADS], parts[:, HEADS:]], 1)
        return mean - left, parts, told

    def _taken(
        self,
        queries: Tensor,
        keys: Tensor,
        trust: Tensor,
        mean: Tensor,
        bias: Tensor | float = 0.0,
    ) -> tuple[Tensor, Tensor]:
        """What the heads, one after another, leave of the mean (B, 1, h, w) of each cell.

        Of queries and keys (B, heads · channels, h, w) and the logits ``trust`` (B, 1, h, w) and
        ``bias``; and what each head takes, and its support, (B, 2 heads, h, w).
        """
        with full_precision(trust):
            shares = self._logits(queries, keys, trust, bias).softmax(-1)
            left, parts = mean.flatten(2).transpose(1, 2), []
            for head in shares[..., :-1].unbind(1):
                parts.append(head @ left)
                left = left - parts[-1]
        taken = torch.cat([*parts, *(1 - shares[..., -1:]).unbind(1)], 2).transpose(1, 2)
        size = mean.shape[2:]
        left = left.transpose(1, 2).unflatten(2, size)  # type: ignore[no-untyped-call]
        return left, taken.unflatten(2, size)  # type: ignore[no-untyped-call]

    def _logits(self, queries: Tensor, keys: Tensor, trust: Tensor, bias: Tensor | float) -> Tensor:
        """Logits (B, heads, cells, cells + 1) of each key and, at the end, of no correction."""
        queries, keys = (
            each.flatten(2).unflatten(1, (HEADS, -1))  # type: ignore[no-untyped-call]
            for each in (queries, keys)
        )
        none = 0 * queries[:, :, :1]  # (B, heads, 1, cells)
        at = _places(trust).flatten(2)[:, None] / self.log_distance.exp().view(1, -1, 1, 1) + none
        far = (at**2).sum(2, keepdim=True) / 2
        queries = torch.cat([queries / math.sqrt(_KEY_CHANNELS), at, -far, none + 1], 2)
        keys = F.pad(torch.cat([keys, at, none + 1], 2), (0, 1))
        nothing = self.nothing.view(1, -1, 1, 1) + none[..., :1]
        last = torch.cat([trust.flatten(2)[:, None] - far, nothing], 3)
        logits: Tensor = queries.transpose(2, 3) @ torch.cat([keys, last], 2) + bias
        return logits.clamp(min=_LEAST_LOGIT)


def robust_mean(values: Tensor, weights: Tensor) -> Tensor:
    """Mean of values (B, 1, H, W), weighted, with less weight of those far from it.

    By reweighting with Cauchy's weights; (B, 1, 1, 1), 0 where all weights are 0.
    """
    weight, mean = weights, torch.zeros_like(weights[:, :, :1, :1])
    for _ in range(_CENTRE_STEPS):
        total = (weight * values).sum((2, 3), keepdim=True)
        mean = total / (weight.sum((2, 3), keepdim=True) + LEAST)
        weight = weights / (1 + ((values - mean) / _CENTRE_SD) ** 2)
    return mean


def unpacked(values: Tensor, channels: int = 1) -> Tensor:
    """Pixels of cells of stride 2, as channels; a convolution is the fastest way to them."""
    pixels = torch.cat([_PIXELS] * channels).to(values.device)
    with full_precision(values):
        return F.conv2d(values.float(), pixels, stride=2, groups=channels)


def pooled(values: Tensor, size: int) -> Tensor:
    """Mean over cells of ``size`` × ``size`` pixels, those at the end may be smaller."""
    if size == 1:
        return values
    return F.avg_pool2d(values, size, ceil_mode=True, count_include_pad=False)


def _places(like: Tensor) -> Tensor:
    """Column and row of each pixel, in widths of the map: (1, 2, h, w)."""
    height, width = like.shape[2:]
    rows = torch.arange(height, device=like.device).float() + 0.5
    columns = torch.arange(width, device=like.device).float() + 0.5
    return torch.stack(torch.meshgrid(columns, rows, indexing="xy"))[None] / width
