"""The depth metrics: one function each, and the table that every report is made from.

A metric is the mean over pixels of what its function returns, put through ``finish``. Keeping the
mean apart from the finish is what lets one definition serve per-image and pooled averaging.

To add a metric, write one function under ``@_metric``; tables, JSON and CSV follow.

Source: Eigen, Puhrsch and Fergus, "Depth Map Prediction from a Single Image using a Multi-Scale
Deep Network", NeurIPS 2014, and the KITTI depth benchmark for ``silog``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy.typing as npt

MIN_DEPTH_M = 1e-3
MAX_DEPTH_M = 10.0

_PART = 1 << 14


@dataclass(frozen=True)  # without slots: what several metrics need is kept in the instance
class DepthPixels:
    """The pixels that count in one comparison.

    Attributes:
        truth_m: (N,) float64, metres, > 0.
        predicted_m: (N,) float64, metres, > 0.
    """

    truth_m: npt.NDArray[np.float64]
    predicted_m: npt.NDArray[np.float64]

    @classmethod
    def of(
        cls,
        truth_m: npt.NDArray[np.floating],
        predicted_m: npt.NDArray[np.floating],
        *,
        min_m: float = MIN_DEPTH_M,
        max_m: float = MAX_DEPTH_M,
    ) -> DepthPixels:
        """Keep the pixels whose truth is strictly inside (min_m, max_m) and clamp the prediction.

        Args:
            truth_m: any shape, metres; anything outside the range, and NaN, is left out.
            predicted_m: the same shape, metres; NaN counts as ``min_m``, infinity as ``max_m``.
            min_m: nearest depth that counts, > 0.
            max_m: farthest depth that counts.

        Raises:
            ValueError: the shapes differ.
        """
        if truth_m.shape != predicted_m.shape:
            raise ValueError(f"truth is {truth_m.shape} but prediction is {predicted_m.shape}")
        valid = (truth_m > min_m) & (truth_m < max_m)
        if valid.all():  # as a protocol's truth always is: a copy by mask costs more than the rest
            truth, predicted = truth_m.ravel(), predicted_m.ravel()
        else:
            truth, predicted = truth_m[valid], predicted_m[valid]
        return cls(
            truth.astype(np.float64, copy=False),
            clamp(predicted.astype(np.float64, copy=False), min_m, max_m),
        )

    def __len__(self) -> int:
        return int(self.truth_m.size)

    @cached_property
    def error_m(self) -> npt.NDArray[np.float64]:
        """(N,) predicted − truth."""
        return self.predicted_m - self.truth_m

    @cached_property
    def ratio(self) -> npt.NDArray[np.float64]:
        """(N,) predicted / truth."""
        return self.predicted_m / self.truth_m

    @cached_property
    def log_error(self) -> npt.NDArray[np.float64]:
        """(N,) ln(predicted) − ln(truth)."""
        return np.log(self.ratio)

    @cached_property
    def worse_ratio(self) -> npt.NDArray[np.float64]:
        """(N,) the larger of predicted / truth and truth / predicted."""
        return np.maximum(self.ratio, self.truth_m / self.predicted_m)

    def parts(self) -> Iterator[DepthPixels]:
        """The same pixels in pieces whose intermediate arrays stay in the processor's cache."""
        for start in range(0, len(self), _PART):
            part = slice(start, start + _PART)
            yield DepthPixels(self.truth_m[part], self.predicted_m[part])


def clamp(
    predicted_m: npt.NDArray[np.float64],
    min_m: float = MIN_DEPTH_M,
    max_m: float = MAX_DEPTH_M,
) -> npt.NDArray[np.float64]:
    """Bring a prediction of any shape into [min_m, max_m]; NaN becomes ``min_m``."""
    at_least: npt.NDArray[np.float64] = np.fmax(predicted_m, min_m)  # which passes NaN over
    return np.minimum(at_least, max_m, out=at_least)


PerPixel: TypeAlias = "npt.NDArray[np.floating] | npt.NDArray[np.bool_]"
Terms: TypeAlias = Callable[[DepthPixels], tuple[PerPixel, ...]]


def _as_is(mean: float) -> float:
    return mean


@dataclass(frozen=True, slots=True)
class Metric:
    """One row of the table.

    Attributes:
        name: the field's name for it, also the key in JSON and CSV.
        terms: per-pixel quantities whose means the metric is made of.
        finish: the means, in the same order, to the value.
        higher_is_better: direction of improvement.
    """

    name: str
    terms: Terms
    finish: Callable[..., float] = _as_is
    higher_is_better: bool = False

    def __call__(self, pixels: DepthPixels) -> float:
        """Value over the pixels of one image; NaN if there are none."""
        if not len(pixels):
            return math.nan
        return self.finish(*(float(np.mean(term)) for term in self.terms(pixels)))


METRICS: dict[str, Metric] = {}
"""Every metric by name, in the order of the table's columns."""


def _metric(
    finish: Callable[..., float] = _as_is, *, higher_is_better: bool = False
) -> Callable[[Terms], Metric]:
    """Enter a function in :data:`METRICS` under its own name."""

    def enter(terms: Terms) -> Metric:
        metric = Metric(terms.__name__, terms, finish, higher_is_better)
        METRICS[metric.name] = metric
        return metric

    return enter


@_metric()
def abs_rel(pixels: DepthPixels) -> tuple[PerPixel, ...]:
    """Mean |g − p| / g."""
    return (np.abs(pixels.error_m) / pixels.truth_m,)


@_metric()
def sq_rel(pixels: DepthPixels) -> tuple[PerPixel, ...]:
    """Mean (g − p)² / g, in metres."""
    return (pixels.error_m**2 / pixels.truth_m,)


@_metric(math.sqrt)
def rmse(pixels: DepthPixels) -> tuple[PerPixel, ...]:
    """√ mean (g − p)², in metres."""
    return (pixels.error_m**2,)


@_metric(math.sqrt)
def rms_log(pixels: DepthPixels) -> tuple[PerPixel, ...]:
    """√ mean (ln g − ln p)²."""
    return (pixels.log_error**2,)


@_metric()
def log10(pixels: DepthPixels) -> tuple[PerPixel, ...]:
    """Mean |log₁₀ g − log₁₀ p|."""
    return (np.abs(pixels.log_error) / math.log(10),)


def _within(pixels: DepthPixels, ratio: float) -> tuple[PerPixel, ...]:
    return (pixels.worse_ratio < ratio,)


@_metric(higher_is_better=True)
def d1(pixels: DepthPixels) -> tuple[PerPixel, ...]:
    """Share of pixels with max(g/p, p/g) < 1.25."""
    return _within(pixels, 1.25)


@_metric(higher_is_better=True)
def d2(pixels: DepthPixels) -> tuple[PerPixel, ...]:
    """Share of pixels with max(g/p, p/g) < 1.25²."""
    return _within(pixels, 1.25**2)


@_metric(higher_is_better=True)
def d3(pixels: DepthPixels) -> tuple[PerPixel, ...]:
    """Share of pixels with max(g/p, p/g) < 1.25³."""
    return _within(pixels, 1.25**3)


def _silog(mean: float, mean_of_squares: float) -> float:
    # Rounding can put an exact scaling a hair below zero.
    return 100 * math.sqrt(max(0.0, mean_of_squares - mean**2))


@_metric(_silog)
def silog(pixels: DepthPixels) -> tuple[PerPixel, ...]:
    """100 · standard deviation of ln p − ln g: the log error that no scale can mend."""
    return pixels.log_error, pixels.log_error**2
