"""Measure what error depth is expected to have once it follows known points.

Figure of merit: the area under the sparsification curve (1 of a random order, 0 of the true one)
and the true mean error beside the expected one, on held-out pairs. The law is

    factor · error^power · (distance + 0.01)^slope,

with the error that is expected without points and the distance to the nearest point that depth
follows, in the image's longer side; of a fit of scale and shift alone, with 1 + 1 / points in place
of the distance. Its numbers (likelihood of Laplace) are those of depthcli/known/points.py. Each
half of the pairs is measured by a law of the other half.

Run with networks that saw none of the held-out scenes::

    python docs/error_with_points.py NYU --model runs/twin --error runs/twin-error
"""

import argparse
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import depthcli
from depthcli.core.options import DepthFit
from depthcli.errors import InputError
from depthcli.inference.pipeline import Pipeline
from depthcli.known.points import KnownDepth
from depthcli.lab.datasets.base import SplitName
from depthcli.lab.datasets.nyu import open_nyu
from depthcli.lab.datasets.prompts import parsed_prompt
from depthcli.lab.evaluation.predictors import Sample
from depthcli.lab.evaluation.task import plan_nyu

PROMPTS = (
    *("uniform:1", "uniform:2", "uniform:5", "uniform:20", "uniform:100", "uniform:500"),
    *("uniform:100,noise=0.02", "uniform:500,noise=0.02,wrong=0.05"),
    *("lidar:4", "lidar:4,noise=0.02,wrong=0.1", "lidar:16", "corners:100", "camera:64"),
)
SIZE_PX = 160, 120
PIXELS = 600  # of each image and prompt
NEAR = 0.01  # of the longer side
BINS = (0, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1, 0.13, 0.16, 0.2, 0.25)

Values = NDArray[np.float64]


def distances(points: KnownDepth, shape: tuple[int, ...]) -> Values:
    """Distance of each pixel to the nearest point, in the longer side: (H, W)."""
    away = np.ones(shape, np.uint8)
    away[points.y, points.x] = 0
    return cv2.distanceTransform(away, cv2.DIST_L2, 5).astype(np.float64) / max(shape)


def samples(
    pipelines: tuple[Pipeline, Pipeline], error: Pipeline, data: Path
) -> Iterator[tuple[int, str, DepthFit, Values]]:
    """Image, prompt, fit, and (PIXELS, 3): logs of error and of distance, and true error."""
    task = plan_nyu(open_nyu(data), SplitName.VAL, None)
    random = np.random.default_rng(0)
    for number, i in enumerate(task.test):
        sample, true_m = Sample(task.dataset, i), task.dataset.depth_m(i)
        expected = error.predict(sample.frame).depth.values
        for prompt in PROMPTS:
            points = sample.known_points(parsed_prompt(prompt)).within(*true_m.shape[::-1])
            for fit in DepthFit:
                pipeline = pipelines[fit is DepthFit.NETWORK]
                try:
                    depth = pipeline.predict(sample.frame, anchors=replace(points, fit=fit)).depth
                except InputError:  # one point for a network; points that contradict
                    continue
                how = depth.provenance.anchor_fit.fit
                if how is fit:
                    true = np.abs(depth.values / true_m - 1)
                    spread = distances(points, true_m.shape) + NEAR
                    if how is DepthFit.GLOBAL:
                        spread[:] = 1 + 1 / depth.provenance.anchor_fit.used
                    maps = expected, spread, true
                    small = [
                        cv2.resize(np.float32(values), SIZE_PX, interpolation=cv2.INTER_AREA)
                        for values in maps
                    ]
                    table = np.stack([np.log(small[0]), np.log(small[1]), small[2]], -1)
                    table = table.reshape(-1, 3).astype(np.float64)
                    table = table[np.isfinite(table).all(axis=1)]
                    yield number, prompt, how, random.permutation(table)[:PIXELS]


def law(tables: Sequence[Values]) -> Values:
    """Log of the factor, power and slope of the greatest likelihood."""
    x = np.concatenate(tables)
    columns = np.stack([np.ones(len(x)), x[:, 0], x[:, 1]], 1)
    numbers = np.zeros(3)
    for _ in range(100):  # Newton's, damped; the loss is convex
        ratio = x[:, 2] / np.exp(columns @ numbers)
        slopes = columns.T * ratio @ columns
        numbers += np.clip(np.linalg.solve(slopes, columns.T @ (ratio - 1)), -0.5, 0.5)
    return numbers


def area(true: Values, expected: Values) -> float:
    """Area between the mean error of the least expected ones and that of the least true ones."""
    counts = np.arange(1, len(true) + 1)

    def below(order: NDArray[np.int64]) -> float:
        return float((np.cumsum(true[order]) / counts).mean())

    best = below(np.argsort(true))
    return (below(np.argsort(expected)) - best) / (float(true.mean()) - best)


def main() -> None:
    """Measure, and print the laws."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--error", type=Path, required=True)
    parser.add_argument("--network", default="prompted")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    plain, network, error = (
        depthcli.load_model(name, provider="cpu", threads=1).pipeline
        for name in (options.model, options.network, options.error)
    )
    tables = defaultdict(list)
    for number, prompt, how, table in samples((plain, network), error, options.data):
        tables[how].append((number, prompt, table))
    middle = 1 + max(n for n, _, _ in tables[DepthFit.GLOBAL]) // 2  # scenes lie side by side
    for how, rows in tables.items():
        halves = [
            law([t for n, _, t in rows if (n < middle) == is_second]) for is_second in (False, True)
        ]
        final = law([t for _, _, t in rows])
        print(f"{how}: factor {np.exp(final[0]):.3g}, power {final[1]:.3f}, slope {final[2]:.3f}")
        scored = [
            (prompt, t[:, 2], np.exp(halves[n >= middle][0] + t[:, :2] @ halves[n >= middle][1:]))
            for n, prompt, t in rows
        ]
        areas = [area(true, expected) for _, true, expected in scored]
        true, expected = (np.concatenate([row[i] for row in scored]) for i in (1, 2))
        print(f"  area {np.mean(areas):.3f}, of all images together {area(true, expected):.3f}")
        for low, high in pairwise(BINS):
            inside = (expected >= low) & (expected < high)
            print(
                f"  expected {low:.1%} to {high:.1%}: {inside.mean():.1%} of pixels, mean "
                f"{expected[inside].mean():.4f}, true {true[inside].mean():.4f}"
            )
        for name in PROMPTS:
            chosen = [row for row in scored if row[0] == name]
            if chosen:
                means = [np.concatenate([row[i] for row in chosen]).mean() for i in (1, 2)]
                mean_area = np.mean([area(t, e) for _, t, e in chosen])
                print(f"  {name:34} true {means[0]:.3f} expected {means[1]:.3f} {mean_area:.2f}")


if __name__ == "__main__":
    main()
