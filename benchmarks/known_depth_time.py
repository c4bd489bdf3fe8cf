"""Time of predictions with known depth, one image of 640×480 at a time, on one thread.

Figure of merit: median time of a prediction by ``prompted``, without reading and writing, and its
ratio to that of ``default`` without known depth. They take turns, on views of
docs/room.jpg, whose known depth is drawn from the estimate of ``default``.
Run: ``python benchmarks/known_depth_time.py [PATTERN ...] [--rounds N]``, with patterns of ``eval
--prompt``
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import cv2
import numpy as np
from tools import Timing, alternate, write_pictures

import depthcli
from depthcli.core.anchors import AnchorPoints
from depthcli.core.types import DepthMap, Frame
from depthcli.lab.datasets.prompts import Prompt, parsed_prompt

PATTERNS = ["uniform:100", "uniform:500", "uniform:3000", "camera:64", "lidar:4"]
IMAGES = 4


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("patterns", nargs="*", default=PATTERNS)
    parser.add_argument("--rounds", type=int, default=10)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    with TemporaryDirectory() as folder:
        frames = [depthcli.read_image(path) for path in write_pictures(Path(folder), IMAGES)]
    default = depthcli.load_model("default", provider="cpu", threads=1).pipeline
    maps = [default.predict(frame).depth for frame in frames]
    jobs = {"default, none": _runs("default", frames, [None] * IMAGES)}
    for pattern in options.patterns:
        prompt = parsed_prompt(pattern)
        points = [
            _points(prompt, *pair, i) for i, pair in enumerate(zip(frames, maps, strict=True))
        ]
        jobs[f"prompted, {pattern}"] = _runs("prompted", frames, points)
    measured = [
        Timing(tuple(seconds / IMAGES for seconds in timing.seconds))
        for timing in alternate(list(jobs.values()), options.rounds)
    ]
    for name, timing in zip(jobs, measured, strict=True):
        ratio = timing.median_s / measured[0].median_s
        print(f"{name:24} {timing}   {ratio:.2f} of the first")


def _points(prompt: Prompt, frame: Frame, depth: DepthMap, seed: int) -> AnchorPoints:
    gray = frame.pixels.max(2).astype(np.float32)
    return AnchorPoints.of_map(prompt.draw(depth.values, gray, np.random.default_rng(seed)))


def _runs(
    name: str, frames: list[Frame], points: list[AnchorPoints | None]
) -> Callable[[], object]:
    """Predictions of all frames by a model, each with its points."""
    pipeline = depthcli.load_model(name, provider="cpu", threads=1).pipeline
    return lambda: [
        pipeline.predict(frame, anchors=one) for frame, one in zip(frames, points, strict=True)
    ]


if __name__ == "__main__":
    main()
