"""The boundary metrics once more, pixel by pixel, sharing no code with the project."""

import math

import cv2
import numpy as np

Map = list[list[float]]
Mask = list[list[bool]]

RADIUS = 4


def edges(depth_m: Map, valid: Mask) -> Mask:
    """OpenCV's detector of Canny on the gradient of log depth."""
    height, width = len(depth_m), len(depth_m[0])
    logs = [
        [math.log(d) if ok else 0.0 for d, ok in zip(*line, strict=True)]
        for line in zip(depth_m, valid, strict=True)
    ]
    gradient = [[_gradient(logs, valid, y, x) for x in range(width)] for y in range(height)]
    across, down = np.moveaxis(np.array(gradient, np.int16), 2, 0)
    step = math.log(1.1) * max(_bell()) * 8192
    found: Mask = (cv2.Canny(across, down, step / 2, step, L2gradient=True) > 0).tolist()
    return found


def _bell() -> list[float]:
    raw = [math.exp(-(i**2) / 4) for i in range(-RADIUS, RADIUS + 1)]
    return [v / math.fsum(raw) for v in raw]


def _gradient(logs: Map, valid: Mask, y: int, x: int) -> tuple[int, int]:
    height, width = len(logs), len(logs[0])
    bell = _bell()
    norm = math.fsum((i - RADIUS) ** 2 * b for i, b in enumerate(bell))
    slope = [8192 * (i - RADIUS) * b / norm for i, b in enumerate(bell)]
    gx = gy = 0.0
    for j in range(2 * RADIUS + 1):
        for i in range(2 * RADIUS + 1):
            row, column = y + j - RADIUS, x + i - RADIUS
            if 0 <= row < height and 0 <= column < width and not valid[row][column]:
                return 0, 0
            value = logs[min(max(row, 0), height - 1)][min(max(column, 0), width - 1)]
            gx += value * slope[i] * bell[j]
            gy += value * slope[j] * bell[i]
    return round(gx), round(gy)


def distances(truth: Mask, predicted: Mask) -> tuple[float, float]:
    """(accuracy, completeness) of two sets of edges."""
    here = [(y, x) for y, line in enumerate(truth) for x, on in enumerate(line) if on]
    there = [(y, x) for y, line in enumerate(predicted) for x, on in enumerate(line) if on]
    if not here:
        return math.nan, math.nan
    if not there:
        return 10.0, 10.0
    to_truth = [min(math.dist(p, q) for q in here) for p in there]
    to_predicted = [min(math.dist(p, q) for q in there) for p in here]
    near = [d for d in to_truth if d < 10]
    if not near:
        return 10.0, 10.0
    both = [min(d, 10.0) for d in to_truth + to_predicted]
    return math.fsum(near) / len(near), math.fsum(both) / len(both)


def edge_f1(truth: Map, predicted: Map, valid: Mask) -> float:
    """Weighted mean over ten ratios of the F1 of mean precision and mean recall, as Depth Pro's."""
    scores, weights = [], []
    for i in range(10):
        ratio, recalls, precisions = 1.05 + 0.2 * i / 9, [], []
        for down, right in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            hits = true_count = predicted_count = 0
            for y in range(len(truth)):
                for x in range(len(truth[0])):
                    row, column = y + down, x + right
                    if not (0 <= row < len(truth) and 0 <= column < len(truth[0])):
                        continue
                    if not (valid[y][x] and valid[row][column]):
                        continue
                    is_true = truth[row][column] / truth[y][x] > ratio
                    is_predicted = predicted[row][column] / predicted[y][x] > ratio
                    hits += is_true and is_predicted
                    true_count += is_true
                    predicted_count += is_predicted
            recalls.append(hits / max(true_count, 1))
            precisions.append(hits / max(predicted_count, 1))
            if i == 0 and true_count:
                weights.append(0.0)  # there is an edge
        recall, precision = sum(recalls) / 4, sum(precisions) / 4
        scores.append(ratio * 2 * recall * precision / ((recall + precision) or 1))
    return sum(scores) / 11.5 if weights else math.nan
