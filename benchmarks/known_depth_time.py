"""Time of predictions with known depth, one image of 640×480 at a time, on one thread.

Figure of merit: median time of a prediction by ``prompted``, without reading and writing, and its
ratio to that of ``default`` without known depth. They take turns, on rendered rooms.
Run: ``python benchmarks/known_depth_time.py [PATTERN ...] [--rounds N]``, with patterns of ``eval
--prompt``
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import cv2
import numpy as np
from tools import Timing, alternate

import depthcli
from depthcli.core.anchors import AnchorPoints
from depthcli.core.types import Frame
from depthcli.datasets.prompts import Prompt, parsed_prompt
from depthcli.datasets.rooms.render import TYPICAL_HFOV_DEG, Pair, RoomSettings, render_pair

PATTERNS = ["uniform:100", "uniform:500", "uniform:3000", "camera:64", "lidar:4"]
SETTINGS = RoomSettings(size=(640, 480), hfov_deg=(TYPICAL_HFOV_DEG, TYPICAL_HFOV_DEG))
ROOMS = 4


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("patterns", nargs="*", default=PATTERNS)
    parser.add_argument("--rounds", type=int, default=10)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rooms = [render_pair(SETTINGS, i) for i in range(ROOMS)]
    frames = [Frame(room.rgb) for room in rooms]
    jobs = {"default, none": _runs("default", frames, [None] * ROOMS)}
    for pattern in options.patterns:
        prompt = parsed_prompt(pattern)
        points = [_points(prompt, room, i) for i, room in enumerate(rooms)]
        jobs[f"prompted, {pattern}"] = _runs("prompted", frames, points)
    measured = [
        Timing(tuple(seconds / ROOMS for seconds in timing.seconds))
        for timing in alternate(list(jobs.values()), options.rounds)
    ]
    for name, timing in zip(jobs, measured, strict=True):
        ratio = timing.median_s / measured[0].median_s
        print(f"{name:24} {timing}   {ratio:.2f} of the first")


def _points(prompt: Prompt, room: Pair, seed: int) -> AnchorPoints:
    gray = room.rgb.max(2).astype(np.float32)
    return AnchorPoints.of_map(prompt.draw(room.depth_m, gray, np.random.default_rng(seed)))


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
