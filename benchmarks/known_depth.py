"""How close depth comes to the truth with few or many known points, on held-out pairs.

Figure of merit: abs_rel over the whole image, mean of the pairs, without points and with

- interpolation: linear between the points alone, without a network (the nearest outside of them);
- global: scale and shift of the map, fitted to the points;
- local: the same, and the rest spread over the map;
- network: of a model that takes the points;

and the share of images that this makes worse than the local fit by more than 2 %. Points
are of the true depth, at random anywhere, in a square of 170 pixels or in a row of the image; with
an error of 2 %; and a quarter of them at 1.2 to 3 times their depth, as seen past an edge. More
are those of ``eval --prompt``.
Run (needs scipy): ``python benchmarks/known_depth.py NYU [--model default] [--network prompted]
[--split val] [--counts 20,100,500] [--prompts lidar:4 ...]``
With ``--rounds N``, the figure of merit is the median time of a prediction by the network, one
image at a time on one thread, and its ratio to that of the model without points: they take turns.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # others would spin on while predictions are timed

import cv2
import numpy as np
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from tools import alternate, parse_options

import depthcli
from depthcli.core.options import DepthFit
from depthcli.core.types import DepthMap
from depthcli.errors import UsageError
from depthcli.known.points import KnownDepth, fit_known_depth
from depthcli.lab.datasets.base import SplitName
from depthcli.lab.datasets.nyu import open_nyu
from depthcli.lab.datasets.prompts import Prompt, parsed_prompt
from depthcli.lab.evaluation.predictors import Sample
from depthcli.lab.evaluation.task import plan_nyu

if TYPE_CHECKING:
    import numpy.typing as npt

    Floats = npt.NDArray[np.float32]

DEPTH_M = 0.4, 10.0
SQUARE_PX = 170
TIMED = 4
CONDITIONS = {
    "exact": (0.0, 0.0, "image"),
    "2 % noise": (0.02, 0.0, "image"),
    "2 % noise, a quarter wrong": (0.02, 0.25, "image"),
    "2 % noise, in a square": (0.02, 0.0, "square"),
    "2 % noise, in a row": (0.02, 0.0, "row"),
}

PROMPTS = [
    pattern + errors
    for pattern in ("corners:100", "lidar:1", "lidar:4", "camera:64")
    for errors in ("", ",noise=0.02,wrong=0.25")
]


def main() -> None:
    """Measure and print."""
    options = parse_options(
        __doc__,
        "data",
        model="default",
        split=SplitName.VAL,
        limit=int,
        network="prompted",
        counts="5,20,100,500",
        prompts=PROMPTS,
        rounds=0,
    )
    task = plan_nyu(open_nyu(options.data), options.split, options.limit)
    prompts = [parsed_prompt(prompt) for prompt in options.prompts]
    pipeline, network = (
        depthcli.load_model(name, provider="cpu", threads=1).pipeline
        for name in (options.model, options.network)
    )
    if options.rounds:
        samples = [Sample(task.dataset, i) for i in task.test[:TIMED]]
        print_times((pipeline, network), samples, prompts, options.rounds)
        return
    pairs = []
    for i in task.test:
        sample = Sample(task.dataset, i)
        pairs.append((sample, pipeline.predict(sample.frame).depth, task.dataset.depth_m(i)))
    plain = np.mean([abs_rel(depth.values, true_m) for _, depth, true_m in pairs])
    print(f"{len(pairs)} pairs, no points: {plain:.4f}")
    print(
        f"{'points':38}{'interpolation':>14}{'global':>10}{'local':>10}{'network':>10}{'worse':>8}"
    )

    def show(name: str, anchors: Iterable[KnownDepth | None]) -> None:
        rows = []
        for (sample, depth, true_m), points in zip(pairs, anchors, strict=True):
            if points:
                depth_m = network.predict(sample.frame, anchors=points).depth.values
                rows.append([*errors(depth, true_m, points), abs_rel(depth_m, true_m)])
        alone, *others = np.nanmean(rows, axis=0)
        worse = np.mean([row[3] > 1.02 * row[2] for row in rows])
        scores = f"{alone:14.4f}{''.join(f'{score:10.4f}' for score in others)}{worse:8.2f}"
        print(f"{name:38}{scores}", flush=True)

    for count in map(int, options.counts.split(",")):
        for name, condition in CONDITIONS.items():
            random = np.random.default_rng(count)
            if condition[2] == "image" or count <= SQUARE_PX:
                anchors = (drawn(true_m, count, condition, random) for _, _, true_m in pairs)
                show(f"{count:<8}{name}", anchors)
    for prompt in prompts:
        show(str(prompt), (sample.known_points(prompt) for sample, _, _ in pairs))


def print_times(
    models: Sequence[depthcli.Pipeline], samples: list[Sample], prompts: list[Prompt], rounds: int
) -> None:
    """Time both on a few images, without reading."""
    cv2.setNumThreads(1)
    pipeline, network = models
    actions = {"no points": lambda: [pipeline.predict(sample.frame) for sample in samples]}
    for prompt in prompts:
        pairs = [(sample.frame, sample.known_points(prompt)) for sample in samples]
        actions[str(prompt)] = lambda pairs=pairs: [
            network.predict(frame, anchors=points) for frame, points in pairs
        ]
    timings = alternate(list(actions.values()), rounds, per=len(samples))
    for name, timing in zip(actions, timings, strict=True):
        print(f"{name:24} {timing}   {timing.median_s / timings[0].median_s:.2f} of the first")


def drawn(
    true_m: Floats, count: int, condition: tuple[float, float, str], random: np.random.Generator
) -> KnownDepth:
    """Points of a map at random, with errors."""
    noise, wrong, where = condition
    height, width = true_m.shape
    rows = {"image": height, "square": SQUARE_PX, "row": 2}[where]
    columns = SQUARE_PX if where == "square" else width
    top, left = random.integers(0, (height - rows + 1, width - columns + 1))
    part = true_m[top : top + rows, left : left + columns]
    chosen = random.choice(np.flatnonzero(part > 0), count, replace=False)
    y, x = np.unravel_index(chosen, part.shape)
    y, x = y + top, x + left
    seen_m = true_m[y, x] * random.normal(1, noise, count)
    is_wrong = random.random(count) < wrong
    seen_m[is_wrong] *= random.uniform(1.2, 3, is_wrong.sum())
    return KnownDepth.of_table(np.stack([x, y, seen_m], axis=1))


def errors(depth: DepthMap, true_m: Floats, points: KnownDepth) -> tuple[float, float, float]:
    """abs_rel of interpolation, of the global fit and of ``--anchors``; NaN where one fails."""
    places = np.stack([points.x, points.y], axis=1)
    y, x = np.mgrid[: true_m.shape[0], : true_m.shape[1]]
    try:
        between = LinearNDInterpolator(places, points.depth_m)(x, y)
    except RuntimeError:  # of Qhull: all points in a line
        between = np.full(true_m.shape, np.nan)
    nearest = NearestNDInterpolator(places, points.depth_m)(x, y)
    alone = abs_rel(np.where(np.isnan(between), nearest, between), true_m)
    try:
        rough = replace(points, fit=DepthFit.GLOBAL)
        fits = [fit_known_depth(depth, some)[0].values for some in (rough, points)]
    except UsageError:
        return alone, np.nan, np.nan
    return alone, abs_rel(fits[0], true_m), abs_rel(fits[1], true_m)


def abs_rel(depth_m: Floats, true_m: Floats) -> float:
    """Mean of |predicted - true| ÷ true; pixels without depth count as the least depth."""
    has = true_m > 0
    clipped_m = np.nan_to_num(depth_m, nan=DEPTH_M[0])[has].clip(*DEPTH_M)
    return float(np.abs(clipped_m / true_m[has] - 1).mean())


if __name__ == "__main__":
    main()
