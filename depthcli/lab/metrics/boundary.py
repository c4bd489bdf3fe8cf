"""Accuracy of depth boundaries.

The other metrics are hardly affected by edges, because few pixels are near one. Here the edges of
both maps are found with one detector and compared, by their distance and pixel by pixel.

Source: Koch et al., "Evaluation of CNN-based Single-Image Depth Estimation Methods", ECCV Workshops
2018 (depth-boundary errors); Bochkovskii et al., "Depth Pro: Sharp Monocular Metric Depth in Less
Than a Second", ICLR 2025 (boundary F1); Canny, "A Computational Approach to Edge Detection", 1986.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from depthcli.core.types import BoolArray, Float32Array, Float64Array, FloatArray

MAX_DISTANCE_PX = 10.0  #: edges farther apart than this are not matched
RATIOS = tuple(np.linspace(1.05, 1.25, 10).tolist())
"""Steps of depth between two neighbours that the F1 averages over; each has its ratio as weight."""

_SIGMA_PX = math.sqrt(2)
_RADIUS_PX = 4
# Canny's thresholds: a step of 10 % of depth is an edge, and so is one of half that which continues
# an edge. A floor seen from 1.2 m above stays below both out to 8 m.
_STRONG_STEP = math.log(1.1)
_WEAK_STEP = _STRONG_STEP / 2
# Canny takes 16-bit gradients; the steepest possible, 1 mm beside 10 m, still fits.
_GRADIENT_SCALE = 8192.0
HIGHER_IS_BETTER = frozenset({"edge_f1"})


class BoundaryScores(NamedTuple):
    """Scores of one image, or their mean over images; NaN where the truth has no edge."""

    #: mean distance in pixels of the predicted edges within 10 px of a true one to that one; lower
    #: is better
    dbe_acc: float
    #: mean distance in pixels of all edges of either map to the other's, truncated at 10; lower is
    #: better. Missing and false edges count
    dbe_comp: float
    #: harmonic mean of precision and recall of the depth steps between neighbouring pixels, each
    #: the mean of those upwards, downwards, to the left and to the right, in [0, 1]; higher is
    #: better
    edge_f1: float


def mean_boundary_scores(images: Sequence[BoundaryScores]) -> BoundaryScores:
    """Mean of each score over the images that have it; NaN for a score that none has."""
    columns = zip(*images, strict=True)
    finite = ([value for value in column if not math.isnan(value)] for column in columns)
    return BoundaryScores(*(math.fsum(c) / len(c) if c else math.nan for c in finite))


def boundary_scores(
    truth_m: FloatArray, predicted_m: FloatArray, valid: BoolArray
) -> BoundaryScores:
    """Compare the edges of one image, (H, W) metres > 0 where ``valid``; others do not count.

    Both distances are NaN if the truth has no edge, and 10 px if no predicted one is near; the F1
    is NaN if the truth has no step of 5 %.
    """
    truth, predicted = _log(truth_m, valid), _log(predicted_m, valid)
    distances = _distances(_edges(truth, valid), _edges(predicted, valid))
    return BoundaryScores(*distances, _edge_f1(truth, predicted, valid))


def _log(depth_m: FloatArray, valid: BoolArray) -> Float32Array:
    return np.log(np.where(valid, depth_m, 1)).astype(np.float32)


def _edges(log_depth: Float32Array, valid: BoolArray) -> BoolArray:
    """Canny's edges of log depth, one pixel wide."""
    # A Gaussian of sum one, and its slope, which gives _GRADIENT_SCALE on a ramp of one.
    offsets = np.arange(-_RADIUS_PX, _RADIUS_PX + 1)
    bell = cv2.getGaussianKernel(len(offsets), _SIGMA_PX)[:, 0]
    smooth: Float32Array = bell.astype(np.float32)
    slope: Float32Array = (_GRADIENT_SCALE * offsets * bell / (offsets**2 * bell).sum()).astype(
        np.float32
    )
    window = np.ones((2 * _RADIUS_PX + 1,) * 2, np.uint8)
    interior = cv2.erode(valid.astype(np.uint8), window, borderValue=1)
    gradients = [
        np.rint(
            interior * cv2.sepFilter2D(log_depth, cv2.CV_32F, *k, borderType=cv2.BORDER_REPLICATE)
        )
        for k in ((slope, smooth), (smooth, slope))
    ]
    x, y = (g.astype(np.int16) for g in gradients)
    # The gradient of a step is highest at its middle, by the smoothing kernel's height there.
    weak, strong = (
        step * float(smooth.max()) * _GRADIENT_SCALE for step in (_WEAK_STEP, _STRONG_STEP)
    )
    return np.asarray(cv2.Canny(x, y, weak, strong, L2gradient=True) > 0)


def _distances(truth: BoolArray, predicted: BoolArray) -> tuple[float, float]:
    """Accuracy and completeness of the depth boundaries, px."""
    if not truth.any():
        return math.nan, math.nan
    if not predicted.any():
        return MAX_DISTANCE_PX, MAX_DISTANCE_PX
    to_truth = _distance_to(truth)[predicted]
    to_predicted = _distance_to(predicted)[truth]
    near = to_truth[to_truth < MAX_DISTANCE_PX]
    if not near.size:
        return MAX_DISTANCE_PX, MAX_DISTANCE_PX
    both = np.minimum(np.concatenate([to_truth, to_predicted]), MAX_DISTANCE_PX)
    return float(near.mean()), float(both.mean())


def _distance_to(edges: BoolArray) -> Float64Array:
    """(H, W) float64: Euclidean distance in pixels to the nearest edge."""
    away = cv2.distanceTransform((~edges).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # Squares of distances are whole numbers; the last digits of OpenCV's roots vary.
    return np.asarray(np.sqrt(np.rint(np.square(away, dtype=np.float64))))


def _edge_f1(truth: Float32Array, predicted: Float32Array, valid: BoolArray) -> float:
    """F1 of the steps between neighbours, averaged over the ratios."""
    true_steps, steps, total = _steps(truth, valid), _steps(predicted, valid), 0.0
    if not any((away > math.log(RATIOS[0])).any() for away in true_steps):
        return math.nan
    for ratio in RATIOS:
        recall = precision = 0.0
        for true_step, step in zip(true_steps, steps, strict=True):
            is_true, is_predicted = true_step > math.log(ratio), step > math.log(ratio)
            hits = float(np.count_nonzero(is_true & is_predicted)) / len(steps)
            recall += hits / (np.count_nonzero(is_true) or 1)
            precision += hits / (np.count_nonzero(is_predicted) or 1)
        if recall + precision:
            total += ratio * 2 * recall * precision / (recall + precision)
    return float(total / sum(RATIOS))


def _steps(log_depth: Float32Array, valid: BoolArray) -> tuple[Float32Array, ...]:
    """Differences to the right, left, below and above, where both pixels count."""
    right = np.diff(log_depth, axis=1)[valid[:, 1:] & valid[:, :-1]]
    down = np.diff(log_depth, axis=0)[valid[1:] & valid[:-1]]
    return right, -right, down, -down
