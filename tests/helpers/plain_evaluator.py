"""The whole evaluation once more in plain NumPy, sharing no code with the project."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Pairs = tuple[Array, Array]
"""True and predicted depth, (N,) each."""


def bilinear(image: Array, width: int, height: int) -> Array:
    """Half-pixel centres, edges repeated; one axis after the other."""
    for size in (height, width):
        places = (np.arange(size) + 0.5) * len(image) / size - 0.5
        image = np.array([np.interp(places, range(len(image)), line) for line in image.T])
    return image


def aligned(truth: Array, predicted: Array, how: str) -> Array:
    if how == "median":
        return predicted * np.median(truth) / np.median(predicted)
    if how == "depth":
        return np.polyval(np.polyfit(predicted, truth, 1), predicted)
    if how == "disparity":
        fitted = np.polyval(np.polyfit(1 / predicted, 1 / truth, 1), 1 / predicted)
        return np.where(fitted > 0, 1 / fitted, np.inf)
    return predicted


def compare(
    truth: Array, predicted: Array, *, how: str = "none", valid: npt.NDArray[np.bool_] | None = None
) -> Pairs:
    """The valid pixels of one image, aligned and clamped."""
    truth, predicted = truth.astype(float), predicted.astype(float)
    if predicted.shape != truth.shape:
        predicted = bilinear(predicted, *truth.shape[::-1])
    counted = (truth > 1e-3) & (truth < 10) & (True if valid is None else valid)
    fitted = aligned(truth[counted], predicted[counted], how)
    return truth[counted], np.nan_to_num(fitted, nan=1e-3, posinf=10).clip(1e-3, 10)


def metrics(pairs: Pairs) -> dict[str, float]:
    g, p = pairs
    logs, ratio = np.log(p) - np.log(g), np.maximum(g / p, p / g)
    return {
        "abs_rel": np.mean(abs(g - p) / g),
        "sq_rel": np.mean((g - p) ** 2 / g),
        "rmse": np.mean((g - p) ** 2) ** 0.5,
        "rms_log": np.mean(logs**2) ** 0.5,
        "log10": np.mean(abs(np.log10(g) - np.log10(p))),
        **{f"d{i}": np.mean(ratio < 1.25**i) for i in (1, 2, 3)},
        "silog": 100 * np.std(logs),
    }


def optional_metrics(pairs: Pairs) -> dict[str, float]:
    g, p = pairs
    return {
        "mae": np.mean(abs(g - p)),
        "imae": 1000 * np.mean(abs(1 / g - 1 / p)),
        "irmse": 1000 * np.mean((1 / g - 1 / p) ** 2) ** 0.5,
        **{f"d{i}": np.mean(np.maximum(g / p, p / g) < i / 100) for i in (105, 110)},
    }


def average(images: Sequence[Pairs], *, pooled: bool = False) -> dict[str, float]:
    if pooled:
        g, p = (np.concatenate(parts) for parts in zip(*images, strict=True))
        return metrics((g, p))
    each = [metrics(pairs) for pairs in images if pairs[0].size]
    return {name: np.mean([scores[name] for scores in each]) for name in each[0]}
