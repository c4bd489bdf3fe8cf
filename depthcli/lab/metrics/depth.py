"""The valid pixels of a comparison, and the depth metrics: one function each, and their table.

A metric is ``finish`` of the mean over pixels, whose sum its function returns. With sum and
``finish`` apart, one definition serves per-image and pooled averaging, and parts of an image.

To add a metric, write one function under ``@_metric``; tables, JSON and CSV follow.

Source: Eigen, Puhrsch and Fergus, "Depth Map Prediction from a Single Image using a Multi-Scale
Deep Network", NeurIPS 2014, and the KITTI depth benchmark for ``silog``.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, Self, TypeAlias

import cv2
import numpy as np

from depthcli.core.types import Float64Array, FloatArray
from depthcli.errors import UsageError
from depthcli.lab.options import Averaging

MIN_DEPTH_M, MAX_DEPTH_M = 1e-3, 10.0
_PART_PIXELS = 77_000  # pixels: longer arrays leave the cache, more parts cost more calls
_PER_KM = 1000  # of 1/m
_MAX_DOT = 10_000  # with more elements, OpenBLAS starts its own threads


@dataclass(frozen=True)  # without slots: cached properties are stored in the instance
class DepthPixels:
    """The valid pixels of a comparison, which properties convert to float64."""

    truth: FloatArray  #: (N,) floats, metres, inside the range
    prediction: FloatArray  #: (N,) floats, metres, any value
    min_m: float = MIN_DEPTH_M  #: predictions are clamped to at least this
    max_m: float = MAX_DEPTH_M  #: predictions are clamped to at most this
    is_reversed: bool = False  #: whether an alignment of the image exchanged near and far

    @classmethod
    def of(
        cls, truth_m: FloatArray, predicted_m: FloatArray, *, max_m: float = MAX_DEPTH_M
    ) -> Self:
        """Pixels with truth between 1 mm and ``max_m``; both are metres of one shape."""
        if truth_m.shape != predicted_m.shape:
            raise ValueError(f"truth is {truth_m.shape} but prediction is {predicted_m.shape}")
        valid = (truth_m > MIN_DEPTH_M) & (truth_m < max_m)
        if valid.all():  # as in most images; a copy by mask would cost more than a metric
            return cls(truth_m.ravel(), predicted_m.ravel(), max_m=max_m)
        return cls(truth_m[valid], predicted_m[valid], max_m=max_m)

    def __len__(self) -> int:
        return int(self.truth.size)

    def parts(self) -> Iterator[Self]:
        """Split the pixels into parts whose float64 arrays fit the processor's cache.

        Without pixels, there is an empty one.
        """
        for start in range(0, max(1, len(self)), _PART_PIXELS):
            part = slice(start, start + _PART_PIXELS)
            yield type(self)(self.truth[part], self.prediction[part], self.min_m, self.max_m)

    @cached_property
    def truth_m(self) -> Float64Array:
        """(N,) g, metres, > 0."""
        return self.truth.astype(np.float64)

    @cached_property
    def predicted_m(self) -> Float64Array:
        """(N,) p, metres, > 0, clamped; NaN becomes ``min_m``."""
        values, low_m, high_m = self.prediction, self.min_m, self.max_m
        exact = values.astype(np.float64)
        if exact.size and low_m <= float(values.min()) and float(values.max()) <= high_m:
            return exact  # the usual case; NaN fails the comparison
        np.clip(exact, low_m, high_m, out=exact)
        exact[np.isnan(exact)] = low_m
        return exact

    @cached_property
    def error_m(self) -> Float64Array:
        """(N,) p − g."""
        return self.predicted_m - self.truth_m

    @cached_property
    def ratio(self) -> Float64Array:
        """(N,) p / g."""
        return self.predicted_m / self.truth_m

    @cached_property
    def relative_error(self) -> Float64Array:
        """(N,) (p − g) / g."""
        return self.ratio - 1

    @cached_property
    def log_error(self) -> Float64Array:
        """(N,) ln p − ln g."""
        return np.log(self.ratio)

    @cached_property
    def squared_log_error(self) -> float:
        """Σ (ln p − ln g)²."""
        return cv2.norm(self.log_error, cv2.NORM_L2SQR)


Sums: TypeAlias = Callable[[DepthPixels], tuple[float, ...]]
Scores: TypeAlias = dict[str, float]  #: values by the names of metrics


@dataclass(frozen=True, slots=True)
class Metric:
    """One row of the table."""

    name: str  #: the field's name for it, also the key in JSON and CSV
    sums: Sums  #: of the per-pixel quantities
    finish: Callable[..., float]  #: the value from their means, in the same order
    higher_is_better: bool  #: direction of improvement
    unit: str  #: of the value, as tables state it; empty if it has none
    is_whole: bool = False  #: whether ``sums`` takes all pixels at once, not parts of them


METRICS: dict[str, Metric] = {}  #: every metric by name, in the order of the table's columns
OPTIONAL: dict[str, Metric] = {}  #: further ones, to be copied into METRICS


def _metric(
    finish: Callable[..., float] = float,
    *,
    higher_is_better: bool = False,
    unit: str = "",
    among: dict[str, Metric] = METRICS,
) -> Callable[[Sums], Metric]:
    """Enter a function in a table by its name; its value is the mean by default."""

    def register(sums: Sums) -> Metric:
        metric = Metric(sums.__name__, sums, finish, higher_is_better, unit)
        among[metric.name] = metric
        return metric

    return register


@_metric()
def abs_rel(pixels: DepthPixels) -> tuple[float, ...]:
    """Mean |g − p| / g."""
    return (cv2.norm(pixels.relative_error, cv2.NORM_L1),)


@_metric(unit="metres")
def sq_rel(pixels: DepthPixels) -> tuple[float, ...]:
    """Mean (g − p)² / g, in metres."""
    pieces = (slice(i, i + _MAX_DOT) for i in range(0, len(pixels), _MAX_DOT))
    products = (np.dot(pixels.error_m[part], pixels.relative_error[part]) for part in pieces)
    return (float(sum(products)),)


@_metric(math.sqrt, unit="metres")
def rmse(pixels: DepthPixels) -> tuple[float, ...]:
    """√ mean (g − p)², in metres."""
    return (cv2.norm(pixels.error_m, cv2.NORM_L2SQR),)


@_metric(math.sqrt)
def rms_log(pixels: DepthPixels) -> tuple[float, ...]:
    """√ mean (ln g − ln p)²."""
    return (pixels.squared_log_error,)


@_metric()
def log10(pixels: DepthPixels) -> tuple[float, ...]:
    """Mean |log₁₀ g − log₁₀ p|."""
    return (cv2.norm(pixels.log_error, cv2.NORM_L1) / math.log(10),)


def _within(pixels: DepthPixels, ratio: float) -> tuple[float, ...]:
    below, too_near = pixels.ratio < ratio, pixels.ratio <= 1 / ratio  # g / p ≥ the ratio
    return (float(np.count_nonzero(below) - np.count_nonzero(too_near)),)


@_metric(higher_is_better=True)
def d1(pixels: DepthPixels) -> tuple[float, ...]:
    """Share of pixels with max(g/p, p/g) < 1.25."""
    return _within(pixels, 1.25)


@_metric(higher_is_better=True)
def d2(pixels: DepthPixels) -> tuple[float, ...]:
    """Share of pixels with max(g/p, p/g) < 1.25²."""
    return _within(pixels, 1.25**2)


@_metric(higher_is_better=True)
def d3(pixels: DepthPixels) -> tuple[float, ...]:
    """Share of pixels with max(g/p, p/g) < 1.25³."""
    return _within(pixels, 1.25**3)


# For an exact scaling, rounding can give a variance just below zero.
@_metric(lambda mean, mean_of_squares: 100 * math.sqrt(max(0.0, mean_of_squares - mean**2)))
def silog(pixels: DepthPixels) -> tuple[float, ...]:
    """100 · standard deviation of ln p − ln g, which does not depend on the scale."""
    return float(pixels.log_error.sum()), pixels.squared_log_error


@_metric(unit="metres", among=OPTIONAL)
def mae(pixels: DepthPixels) -> tuple[float, ...]:
    """Mean |g − p|, in metres."""
    return (cv2.norm(pixels.error_m, cv2.NORM_L1),)


@_metric(unit="1/km", among=OPTIONAL)
def imae(pixels: DepthPixels) -> tuple[float, ...]:
    """Mean |1/g − 1/p|, in 1/km, as KITTI's benchmarks have it."""
    return (_PER_KM * cv2.norm(_inverse_error(pixels), cv2.NORM_L1),)


@_metric(lambda mean: _PER_KM * math.sqrt(mean), unit="1/km", among=OPTIONAL)
def irmse(pixels: DepthPixels) -> tuple[float, ...]:
    """√ mean (1/g − 1/p)², in 1/km."""
    return (cv2.norm(_inverse_error(pixels), cv2.NORM_L2SQR),)


def _inverse_error(pixels: DepthPixels) -> Float64Array:
    return pixels.error_m / (pixels.truth_m * pixels.predicted_m)


@_metric(higher_is_better=True, among=OPTIONAL)
def d105(pixels: DepthPixels) -> tuple[float, ...]:
    """Share of pixels with max(g/p, p/g) < 1.05."""
    return _within(pixels, 1.05)


@_metric(higher_is_better=True, among=OPTIONAL)
def d110(pixels: DepthPixels) -> tuple[float, ...]:
    """Share of pixels with max(g/p, p/g) < 1.10."""
    return _within(pixels, 1.10)


def add_metric(name: str, function: Callable[[Float64Array, Float64Array], float]) -> None:
    """Enter a function of true and predicted metres, (N,) float64, of the pixels of one image.

    Its attributes ``higher_is_better`` and ``unit`` describe it. Pooled, images weigh by their
    pixels.
    """
    if name in METRICS and not METRICS[name].is_whole:
        raise UsageError(f"there is a metric {name}", "rename the function", option="metric")

    def sums(pixels: DepthPixels) -> tuple[float, ...]:
        count = len(pixels)
        return (count * float(function(pixels.truth_m, pixels.predicted_m)) if count else 0.0,)

    higher, unit = getattr(function, "higher_is_better", False), getattr(function, "unit", "")
    METRICS[name] = Metric(name, sums, float, higher, unit, is_whole=True)


def in_full(scores: Mapping[str, float]) -> Scores:
    """Scores of every metric, in the order of the table, then others; NaN for those missing."""
    return dict.fromkeys(METRICS, math.nan) | dict(scores)


def finite_or_none(value: Any) -> Any:  # noqa: ANN401 - what JSON can hold
    """A value for JSON, in which numbers that are not finite are None."""
    if isinstance(value, dict):
        return {name: finite_or_none(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite_or_none(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@dataclass(frozen=True, slots=True)
class PixelSums:
    """Sums of every metric, which can be computed in parallel and added."""

    pixel_count: int  #: how many pixels
    sums: tuple[tuple[float, ...], ...]  #: those of each metric, in the order of the table

    @classmethod
    def of(cls, pixels: DepthPixels) -> Self:
        """Sums over the pixels of one image; thread-safe."""
        others = [metric for metric in METRICS.values() if not metric.is_whole]
        parts = [[metric.sums(part) for metric in others] for part in pixels.parts()]
        columns = zip(*parts, strict=True)
        sums = (tuple(map(sum, zip(*column, strict=True))) for column in columns)
        every = (m.sums(pixels) if m.is_whole else next(sums) for m in METRICS.values())
        return cls(len(pixels), tuple(every))

    def __add__(self, other: Self) -> Self:
        pairs = zip(self.sums, other.sums, strict=True)
        added = tuple(tuple(a + b for a, b in zip(x, y, strict=True)) for x, y in pairs)
        return type(self)(self.pixel_count + other.pixel_count, added)

    def scores(self) -> Scores:
        """Every metric over these pixels; NaN if there are none."""
        if not self.pixel_count:
            return in_full({})
        metrics = zip(METRICS.values(), self.sums, strict=True)
        return {m.name: m.finish(*(s / self.pixel_count for s in sums)) for m, sums in metrics}


def mean_scores(images: Iterable[PixelSums], averaging: Averaging = Averaging.IMAGE) -> Scores:
    """Average over the images with a valid pixel; NaN for every metric if none has one.

    >>> import numpy as np
    >>> truth = np.array([1.0, 2.0, 4.0])
    >>> round(mean_scores([PixelSums.of(DepthPixels.of(truth, truth * 1.1))])["abs_rel"], 6)
    0.1
    """
    scored = [sums for sums in images if sums.pixel_count]
    if averaging is Averaging.POOLED and scored:
        return reduce(PixelSums.__add__, scored).scores()
    return mean_of([sums.scores() for sums in scored])


def mean_of(scores: Sequence[Scores]) -> Scores:
    """Mean of every metric; NaN if there are no scores."""
    if not scores:
        return in_full({})
    return dict(zip(METRICS, map(float, values_of(scores).mean(0)), strict=True))


def values_of(scores: Iterable[Scores]) -> Float64Array:
    """(N, metrics) float64 of N scores, in the order of the table."""
    return np.array([[in_full(each)[name] for name in METRICS] for each in scores], np.float64)
