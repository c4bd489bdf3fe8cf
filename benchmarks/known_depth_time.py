"""Time of predictions with known depth, one image of 640×480 at a time, on one thread.

Figure of merit: median time of a prediction by ``prompted``, without reading and writing, and its
ratio to that of ``default`` without known depth. They take turns, on views of a room; known depth
is drawn from that of ``default``.
Run: ``python benchmarks/known_depth_time.py [PATTERN ...] [--rounds N]``, with patterns of ``eval
--prompt``
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import cv2
import numpy as np
from tools import alternate, parse_options, write_pictures

import depthcli
from depthcli.core.anchors import AnchorPoints
from depthcli.lab.datasets.prompts import parsed_prompt

if TYPE_CHECKING:
    from collections.abc import Callable

    from depthcli.core.types import Frame

PATTERNS = ["uniform:100", "uniform:500", "uniform:3000", "camera:64", "lidar:4"]
VIEWS = 4


def main() -> None:
    """Measure and print."""
    options = parse_options(__doc__, rest=("patterns", PATTERNS), rounds=10)
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        frames = [depthcli.read_image(path) for path in write_pictures(Path(folder), VIEWS)]
    default, prompted = (
        depthcli.load_model(name, provider="cpu", threads=1).pipeline
        for name in ("default", "prompted")
    )
    depths_m = [default.predict(frame).depth.values for frame in frames]
    actions = {"default, none": runs(default, frames, [None] * VIEWS)}
    for pattern in options.patterns:
        points = [drawn(pattern, *pair) for pair in zip(frames, depths_m, strict=True)]
        actions[f"prompted, {pattern}"] = runs(prompted, frames, points)
    timings = alternate(list(actions.values()), options.rounds, per=VIEWS)
    for name, timing in zip(actions, timings, strict=True):
        print(f"{name:24} {timing}   {timing.median_s / timings[0].median_s:.2f} of the first")


def drawn(pattern: str, frame: Frame, depth_m: np.ndarray) -> AnchorPoints:
    """Points of a map by a pattern."""
    gray = frame.pixels_8bit().max(2).astype(np.float32)
    return AnchorPoints.of_map(parsed_prompt(pattern).draw(depth_m, gray, np.random.default_rng(0)))


def runs(
    pipeline: depthcli.Pipeline, frames: list[Frame], points: list[AnchorPoints | None]
) -> Callable[[], object]:
    """Predictions of all frames by a model, each with its points."""
    return lambda: [
        pipeline.predict(frame, anchors=anchors)
        for frame, anchors in zip(frames, points, strict=True)
    ]


if __name__ == "__main__":
    main()
