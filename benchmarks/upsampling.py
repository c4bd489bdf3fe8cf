"""What the ways to full size do to edges, to accuracy and to time.

Figures of merit, on held-out pairs of NYU Depth v2: the boundary metrics and the depth metrics of
bilinear and guided upsampling and of tiles; and the milliseconds of the network, of each way from
its output to full size, and of the whole way from pixels to depth, at 640×480 and at 4000×3000,
timed in turn on one thread.
Run: ``python benchmarks/upsampling.py NYU [--split val] [--limit N]``
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from tools import alternate

import depthcli
from depthcli.core.options import AUTO_TILE, Upsampling, UpsamplingOptions
from depthcli.core.types import Frame
from depthcli.inference.transforms import coarse_depth, full_size, prepare
from depthcli.lab.datasets.base import SplitName
from depthcli.lab.datasets.nyu import open_nyu
from depthcli.lab.evaluation.evaluate import EvalOptions, evaluate
from depthcli.lab.evaluation.predictors import ModelPredictor
from depthcli.lab.evaluation.protocol import EvalProtocol
from depthcli.lab.evaluation.report import Source
from depthcli.lab.evaluation.task import plan_nyu

if TYPE_CHECKING:
    from collections.abc import Callable

    from depthcli.inference.session import Session
    from depthcli.lab.evaluation.task import EvalTask

WAYS = {
    "bilinear": UpsamplingOptions(Upsampling.BILINEAR),
    "guided": UpsamplingOptions(Upsampling.GUIDED),
    "bilinear, tiles": UpsamplingOptions(Upsampling.BILINEAR, AUTO_TILE),
    "guided, tiles": UpsamplingOptions(Upsampling.GUIDED, AUTO_TILE),
}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--split", type=SplitName, default=SplitName.VAL)
    parser.add_argument("--limit", type=int)
    parser.add_argument("--model")
    parser.add_argument("--runs", type=int, default=60)
    options = parser.parse_args()
    task = plan_nyu(open_nyu(options.data), options.split, options.limit)
    session = depthcli.load_model(options.model, provider="cpu", threads=1).pipeline.session
    _print_scores(task, session)
    cv2.setNumThreads(1)
    pixels = task.dataset.image(task.test[0])
    large = cv2.resize(pixels, (4000, 3000), interpolation=cv2.INTER_CUBIC).astype(np.uint8)
    _print_times(Frame(pixels), session, options.runs)
    _print_times(Frame(large), session, max(5, options.runs // 6))


def _print_scores(task: EvalTask, session: Session) -> None:
    predictors = [
        ModelPredictor(
            name,
            Source.MODEL,
            session.model.card.output.kind,
            "metric, m",
            depthcli.Pipeline(session, way),
        )
        for name, way in WAYS.items()
    ]
    report = evaluate(task, predictors, EvalOptions(EvalProtocol(boundary=True), trivial=False))
    print(report.title)
    print(f"{'':16}" + "".join(f"{name:>10}" for name in (*_DEPTH, *_EDGES)))
    for row in report.rows:
        named = dict(row.items(boundary=True))
        values = [f"{named[name]:10.5f}" for name in (*_DEPTH, *_EDGES)]
        print(f"{row.name:16}" + "".join(values))


_DEPTH = ("abs_rel", "rmse", "d1")
_EDGES = ("dbe_acc", "dbe_comp", "edge_f1")


def _print_times(frame: Frame, session: Session, runs: int) -> None:
    card = session.model.card
    batch, place = prepare(card.input, frame)
    coarse = coarse_depth(card.output, session.run(batch)[0], place)
    actions: dict[str, Callable[[], object]] = {
        "network alone": lambda: session.run(batch),
        "bilinear alone": lambda: full_size(card.output, coarse, frame, Upsampling.BILINEAR),
        "guided alone": lambda: full_size(card.output, coarse, frame, Upsampling.GUIDED),
    }
    for name, way in WAYS.items():
        pipeline = depthcli.Pipeline(session, way)
        actions[f"predict, {name}"] = partial(pipeline.predict, frame)
    print(f"\n{frame.width}×{frame.height}")
    timings = alternate(list(actions.values()), runs)
    for name, timing in zip(actions, timings, strict=True):
        ratio = timing.median_s / timings[0].median_s
        print(f"{name:26}{timing}  {ratio:.2f} × the network")


if __name__ == "__main__":
    main()
