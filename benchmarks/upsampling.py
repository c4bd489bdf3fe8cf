"""What the ways to full size do to edges, to accuracy and to time.

Figures of merit, on held-out pairs of NYU Depth v2: the boundary metrics and abs_rel of bilinear
and guided upsampling and of tiles, and the milliseconds of each step from the network's output to
640×480, timed in turn on one thread.
Run: ``python benchmarks/upsampling.py NYU [--split val] [--limit N]``
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
from timing import alternate

import depthcli
from depthcli.core.choices import AUTO_TILE, Detail, Upsampling
from depthcli.core.types import Frame
from depthcli.datasets.nyu import open_nyu
from depthcli.datasets.splits import SplitName
from depthcli.evaluation.models import ModelPredictor
from depthcli.evaluation.nyu import evaluate_nyu, plan_nyu
from depthcli.evaluation.protocol import Protocol
from depthcli.inference.postprocess import coarse_depth, full_size
from depthcli.inference.preprocess import prepare

if TYPE_CHECKING:
    from depthcli.evaluation.nyu import NyuTask
    from depthcli.inference.session import Session

WAYS = {
    "bilinear": Detail(Upsampling.BILINEAR),
    "guided": Detail(Upsampling.GUIDED),
    "bilinear, tiles": Detail(Upsampling.BILINEAR, AUTO_TILE),
    "guided, tiles": Detail(Upsampling.GUIDED, AUTO_TILE),
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
    session = depthcli.load(options.model, provider="cpu").session
    _print_scores(task, session)
    print()
    _print_times(task, session, options.runs)


def _print_scores(task: NyuTask, session: Session) -> None:
    predictors = [
        ModelPredictor(
            name,
            session.model.card.output.kind,
            session.model.sha256,
            depthcli.Pipeline(session, way),
        )
        for name, way in WAYS.items()
    ]
    report = evaluate_nyu(task, predictors, protocol=Protocol(boundary=True), trivial=False)
    print(report.title)
    print(f"{'':16}" + "".join(f"{name:>10}" for name in ("abs_rel", "rmse", *_EDGES)))
    for row in report.rows:
        named = dict(row.items(boundary=True))
        values = [f"{named[name]:10.5f}" for name in ("abs_rel", "rmse", *_EDGES)]
        print(f"{row.name:16}" + "".join(values))


_EDGES = ("dbe_acc", "dbe_comp", "edge_f1")


def _print_times(task: NyuTask, session: Session, runs: int) -> None:
    cv2.setNumThreads(1)
    frame = Frame(task.dataset.image(task.test[0]))
    card = session.model.card
    batch, place = prepare(card.input, frame)
    coarse = coarse_depth(card.output, session.run(batch)[0], place)
    timings = alternate(
        [
            lambda: full_size(card.output, coarse, frame, Upsampling.BILINEAR),
            lambda: full_size(card.output, coarse, frame, Upsampling.GUIDED),
            *(
                lambda way=way: depthcli.Pipeline(session, way).predict(frame)
                for way in WAYS.values()
            ),
        ],
        runs,
    )
    names = ["bilinear alone", "guided alone", *(f"predict, {name}" for name in WAYS)]
    for name, timing in zip(names, timings, strict=True):
        print(f"{name:26}{timing}")


if __name__ == "__main__":
    main()
