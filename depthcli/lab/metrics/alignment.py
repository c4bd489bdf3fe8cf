"""Aligning a prediction with the ground truth of the same image before they are compared.

Alignment uses the ground truth, so aligned scores are not comparable with unaligned ones.
Predictions of relative depth can only be compared with alignment.

Source: Ranftl et al., "Towards Robust Monocular Depth Estimation", TPAMI 2022 (least squares in
disparity); Zhou et al., "Unsupervised Learning of Depth and Ego-Motion from Video", CVPR 2017
(median scaling).
"""

import numpy as np

from depthcli.core.types import DepthKind, Float64Array
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
            usable = np.isfinite(predicted) & (predicted > 0)
            if not usable.any():
                return predicted, False
            return predicted * (np.median(truth_m[usable]) / np.median(predicted[usable])), False
        case Alignment.DEPTH:
            return _fit_line(predicted, truth_m)
        case Alignment.DISPARITY:
            if kind is not DepthKind.INVERSE:  # zero for infinity, NaN where it is not positive
                unknown = np.full_like(predicted, np.nan)
                predicted = np.divide(1.0, predicted, out=unknown, where=predicted > 0)
            fitted, is_reversed = _fit_line(predicted, 1 / truth_m)
            depth_m = np.full_like(fitted, np.inf)  # where disparity is not positive
            return np.divide(1.0, fitted, out=depth_m, where=~(fitted <= 0)), is_reversed


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
