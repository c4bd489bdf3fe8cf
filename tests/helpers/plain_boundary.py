"""The boundary metrics once more in plain NumPy, sharing no code with the project."""

import math

import cv2
import numpy as np
import numpy.typing as npt

Map = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

RADIUS = 4
PLACES = np.arange(-RADIUS, RADIUS + 1)
BELL = np.exp(-(PLACES**2) / 4)
BELL /= BELL.sum()
SLOPE = 8192 * PLACES * BELL / (PLACES**2 * BELL).sum()
ACROSS, DOWN = (np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])


def edges(depth_m: Map, valid: Mask) -> Mask:
    """OpenCV's detector of Canny on the gradient of log depth."""
    logs = np.pad(np.log(np.where(valid, depth_m, 1)), RADIUS, "edge")
    whole = np.pad(valid, RADIUS, constant_values=True)
    size = (2 * RADIUS + 1,) * 2
    parts = np.lib.stride_tricks.sliding_window_view(logs, size)
    is_whole = np.lib.stride_tricks.sliding_window_view(whole, size).all((2, 3))
    across, down = (
        (is_whole * np.rint(np.einsum("yxji,j,i->yx", parts, *kernels))).astype(np.int16)
        for kernels in ((BELL, SLOPE), (SLOPE, BELL))
    )
    step = math.log(1.1) * BELL.max() * 8192
    return cv2.Canny(across, down, step / 2, step, L2gradient=True) > 0


def distances(truth: Mask, predicted: Mask) -> tuple[float, float]:
    """(accuracy, completeness) of two sets of edges, neither of them empty."""
    apart = np.linalg.norm(np.argwhere(truth)[:, None] - np.argwhere(predicted), axis=2)
    to_truth, to_predicted = apart.min(0), apart.min(1)
    both = np.concatenate([to_truth, to_predicted]).clip(max=10)
    return to_truth[to_truth < 10].mean(), both.mean()


def edge_f1(truth: Map, predicted: Map, valid: Mask) -> float:
    """Weighted mean over ten ratios of the F1 of mean precision and mean recall, as Depth Pro's."""
    total = 0.0
    for ratio in np.linspace(1.05, 1.25, 10):
        recalls, precisions = [], []
        for offset, other in (ACROSS, ACROSS[::-1], DOWN, DOWN[::-1]):
            both = valid[offset] & valid[other]
            is_true, is_predicted = (
                both & (depth_m[offset] / depth_m[other] > ratio) for depth_m in (truth, predicted)
            )
            hits = (is_true & is_predicted).sum()
            recalls.append(hits / max(is_true.sum(), 1))
            precisions.append(hits / max(is_predicted.sum(), 1))
        recall, precision = np.mean(recalls), np.mean(precisions)
        total += ratio * 2 * recall * precision / ((recall + precision) or 1)
    return total / 11.5
