"""The whole evaluation once more, pixel by pixel, sharing no code with the project."""

import math
from collections.abc import Callable, Sequence

Image = list[list[float]]
Pairs = list[tuple[float, float]]


def bilinear(image: Image, width: int, height: int) -> Image:
    """Half-pixel centres, edges repeated."""
    rows, columns = len(image), len(image[0])
    out = []
    for y in range(height):
        y0, y1, fy = _taps(y, height, rows)
        line = []
        for x in range(width):
            x0, x1, fx = _taps(x, width, columns)
            top = image[y0][x0] * (1 - fx) + image[y0][x1] * fx
            bottom = image[y1][x0] * (1 - fx) + image[y1][x1] * fx
            line.append(top * (1 - fy) + bottom * fy)
        out.append(line)
    return out


def _taps(i: int, size: int, source: int) -> tuple[int, int, float]:
    position = min(max((i + 0.5) * source / size - 0.5, 0.0), source - 1.0)
    first = math.floor(position)
    return first, min(first + 1, source - 1), position - first


def mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)


def median(values: Sequence[float]) -> float:
    ordered = sorted(values)
    middle = len(ordered) // 2
    return ordered[middle] if len(ordered) % 2 else (ordered[middle - 1] + ordered[middle]) / 2


def clamp(value: float) -> float:
    if math.isnan(value):
        return 1e-3
    return min(max(value, 1e-3), 10.0)


def line_fit(x: Sequence[float], y: Sequence[float]) -> Callable[[float], float]:
    """Normal equations, by hand."""
    n, sx, sy = len(x), math.fsum(x), math.fsum(y)
    sxx = math.fsum(a * a for a in x)
    sxy = math.fsum(a * b for a, b in zip(x, y, strict=True))
    scale = (n * sxy - sx * sy) / (n * sxx - sx * sx)
    shift = (sy - scale * sx) / n
    return lambda value: scale * value + shift


def aligned(pairs: Pairs, how: str) -> Pairs:
    truth, predicted = [g for g, _ in pairs], [p for _, p in pairs]
    if how == "median":
        factor = median(truth) / median(predicted)
        return [(g, p * factor) for g, p in pairs]
    if how == "depth":
        fit = line_fit(predicted, truth)
        return [(g, fit(p)) for g, p in pairs]
    if how == "disparity":
        fit = line_fit([1 / p for p in predicted], [1 / g for g in truth])
        fitted = [(g, fit(1 / p)) for g, p in pairs]
        return [(g, 1 / d if d > 0 else math.inf) for g, d in fitted]
    return pairs


def compare(
    truth: Image, predicted: Image, *, how: str = "none", valid: list[list[bool]] | None = None
) -> Pairs:
    """(truth, prediction) of the valid pixels of one image, aligned and clamped."""
    height, width = len(truth), len(truth[0])
    if (len(predicted), len(predicted[0])) != (height, width):
        predicted = bilinear(predicted, width, height)
    pairs = []
    for y in range(height):
        for x in range(width):
            if 1e-3 < truth[y][x] < 10 and (valid is None or valid[y][x]):
                pairs.append((truth[y][x], predicted[y][x]))  # noqa: PERF401 - plain on purpose
    return [(g, clamp(p)) for g, p in aligned(pairs, how)]


def metrics(pairs: Pairs) -> dict[str, float]:
    logs = [math.log(p) - math.log(g) for g, p in pairs]
    return {
        "abs_rel": mean([abs(g - p) / g for g, p in pairs]),
        "sq_rel": mean([(g - p) ** 2 / g for g, p in pairs]),
        "rmse": math.sqrt(mean([(g - p) ** 2 for g, p in pairs])),
        "rms_log": math.sqrt(mean([x**2 for x in logs])),
        "log10": mean([abs(math.log10(g) - math.log10(p)) for g, p in pairs]),
        "d1": mean([float(max(g / p, p / g) < 1.25) for g, p in pairs]),
        "d2": mean([float(max(g / p, p / g) < 1.25**2) for g, p in pairs]),
        "d3": mean([float(max(g / p, p / g) < 1.25**3) for g, p in pairs]),
        "silog": 100 * math.sqrt(mean([(x - mean(logs)) ** 2 for x in logs])),
    }


def optional_metrics(pairs: Pairs) -> dict[str, float]:
    return {
        "mae": mean([abs(g - p) for g, p in pairs]),
        "imae": 1000 * mean([abs(1 / g - 1 / p) for g, p in pairs]),
        "irmse": 1000 * math.sqrt(mean([(1 / g - 1 / p) ** 2 for g, p in pairs])),
        "d105": mean([float(max(g / p, p / g) < 1.05) for g, p in pairs]),
        "d110": mean([float(max(g / p, p / g) < 1.10) for g, p in pairs]),
    }


def average(images: Sequence[Pairs], *, pooled: bool = False) -> dict[str, float]:
    if pooled:
        return metrics([pair for pairs in images for pair in pairs])
    each = [metrics(pairs) for pairs in images if pairs]
    return {name: mean([scores[name] for scores in each]) for name in each[0]}
