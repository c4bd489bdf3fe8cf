"""The depth metrics: one function each, and the table that every report is made from.

A metric is ``finish`` of the mean over pixels, whose sum its function returns. With sum and
``finish`` apart, one definition serves per-image and pooled averaging, and parts of an image.

To add a metric, write one function under ``@_metric``; tables, JSON and CSV follow.

Source: Eigen, Puhrsch and Fergus, "Depth Map Prediction from a Single Image using a Multi-Scale
Deep Network", NeurIPS 2014, and the KITTI depth benchmark for ``silog``.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.metrics.pixels import DepthPixels

_MAX_DOT = 10_000  # with more elements, OpenBLAS starts its own threads


def _product(left: npt.NDArray[np.float64], right: npt.NDArray[np.float64]) -> float:
    """Σ left · right, in steps that are too short for the library to start threads."""
    starts = range(0, len(left), _MAX_DOT)
    return float(sum(np.dot(left[i : i + _MAX_DOT], right[i : i + _MAX_DOT]) for i in starts))


Sums: TypeAlias = Callable[[DepthPixels], tuple[float, ...]]


@dataclass(frozen=True, slots=True)
class Metric:
    """One row of the table."""

    name: str  #: the field's name for it, also the key in JSON and CSV
    sums: Sums  #: of the per-pixel quantities
    finish: Callable[..., float]  #: the value from their means, in the same order
    higher_is_better: bool  #: direction of improvement


METRICS: dict[str, Metric] = {}
"""Every metric by name, in the order of the table's columns."""


def _metric(
    finish: Callable[..., float] = float, *, higher_is_better: bool = False
) -> Callable[[Sums], Metric]:
    """Enter a function in :data:`METRICS` by its name; its value is the mean by default."""

    def register(sums: Sums) -> Metric:
        metric = Metric(sums.__name__, sums, finish, higher_is_better)
        METRICS[metric.name] = metric
        return metric

    return register


@_metric()
def abs_rel(pixels: DepthPixels) -> tuple[float, ...]:
    """Mean |g − p| / g."""
    return (cv2.norm(pixels.relative_error, cv2.NORM_L1),)


@_metric()
def sq_rel(pixels: DepthPixels) -> tuple[float, ...]:
    """Mean (g − p)² / g, in metres."""
    return (_product(pixels.error_m, pixels.relative_error),)


@_metric(math.sqrt)
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


def _silog(mean: float, mean_of_squares: float) -> float:
    # For an exact scaling, rounding can give a value just below zero.
    return 100 * math.sqrt(max(0.0, mean_of_squares - mean**2))


@_metric(_silog)
def silog(pixels: DepthPixels) -> tuple[float, ...]:
    """100 · standard deviation of ln p − ln g, which does not depend on the scale."""
    return float(pixels.log_error.sum()), pixels.squared_log_error
