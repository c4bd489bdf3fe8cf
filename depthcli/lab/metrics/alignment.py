"""Aligning a prediction with the ground truth of the same image before they are compared.

Alignment uses the ground truth, so aligned scores are not comparable with unaligned ones.
Predictions of relative depth can only be compared with alignment.

Source: Ranftl et al., "Towards Robust Monocular Depth Estimation", TPAMI 2022 (least squares in
disparity); Zhou et al., "Unsupervised Learning of Depth and Ego-Motion from Video", CVPR 2017
(median scaling).
"""

import numpy as np

from depthcli.core.arrays import Float64Array
from depthcli.core.types import DepthKind
from depthcli.lab.options import Alignment

SUITABLE: dict[DepthKind, tuple[Alignment, ...]] = {
    DepthKind.METRIC: tuple(Alignment),
    DepthKind.RELATIVE: (Alignment.DEPTH,),
    DepthKind.INVERSE: (Alignment.DISPARITY,),
}
"""Alignments of each kind of prediction; depth known up to scale and shift has no reciprocal."""


def align(
    predicted: Float64Array,
    truth_m: Float64Array,
    alignment: Alignment,
    kind: DepthKind = DepthKind.METRIC,
) -> tuple[Float64Array, bool]:
    """Fit a prediction (N,) of some kind to metres > 0; and whether the fit exchanges near and far.

    The depth is float64 metres, not clamped: NaN where there was no prediction, infinity where the
    fitted disparity is not positive. A prediction without a usable pixel is returned unchanged.
    """
    if alignment not in SUITABLE[kind]:
        raise ValueError(f"{kind} depth cannot be aligned by {alignment}")
    match alignment:
        case Alignment.NONE:
            return predicted, False
        case Alignment.MEDIAN:
            return _scale_median(predicted, truth_m), False
        case Alignment.DEPTH:
            return _fit_line(predicted, truth_m)
        case Alignment.DISPARITY:
            fitted, is_reversed = _fit_line(_disparity(predicted, kind), 1 / truth_m)
            return _depth_of_disparity(fitted), is_reversed


def _scale_median(predicted: Float64Array, truth_m: Float64Array) -> Float64Array:
    usable = np.isfinite(predicted) & (predicted > 0)
    if not usable.any():
        return predicted
    return predicted * (np.median(truth_m[usable]) / np.median(predicted[usable]))


def _fit_line(x: Float64Array, y: Float64Array) -> tuple[Float64Array, bool]:
    """``s·x + t`` with the s and t that minimize Σ(s·x + t − y)² over finite x, and if s < 0."""
    usable = np.isfinite(x)
    if not usable.any():
        return x, False
    mean_x, mean_y = x[usable].mean(), y[usable].mean()
    centred = x[usable] - mean_x
    spread = float(centred @ centred)
    # A constant prediction has no slope to fit, only the mean.
    negligible = 1e-24 * centred.size * max(mean_x**2, np.finfo(np.float64).tiny)
    slope = float(centred @ (y[usable] - mean_y)) / spread if spread > negligible else 0.0
    if slope == 0:
        return np.where(np.isnan(x), np.nan, mean_y), False
    return np.asarray(slope * (x - mean_x) + mean_y), slope < 0


def _disparity(predicted: Float64Array, kind: DepthKind) -> Float64Array:
    """1/depth: zero for infinity, NaN where depth is not positive."""
    if kind is DepthKind.INVERSE:
        return predicted
    return np.divide(1.0, predicted, out=np.full_like(predicted, np.nan), where=predicted > 0)


def _depth_of_disparity(disparity: Float64Array) -> Float64Array:
    """1/disparity; infinity where disparity is not positive, NaN where it is NaN."""
    depth_m = np.full_like(disparity, np.inf)
    np.divide(1.0, disparity, out=depth_m, where=~(disparity <= 0))
    return depth_m
