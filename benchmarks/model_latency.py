"""Latency of models alone, one image at a time, in milliseconds.

Figure of merit: median ms an image, beside a fixed matrix product as the machine's yardstick, and
its ratio to that of the first model. Models take turns, ten images each.
Run: ``python benchmarks/model_latency.py [MODEL ...] [--threads N]``
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

# Threads of the yardstick would spin on, while the model is measured on the same cores.
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from tools import alternate, parse_options

import depthcli

if TYPE_CHECKING:
    from collections.abc import Callable

TURN = 10


def main() -> None:
    """Measure and print."""
    options = parse_options(__doc__, rest=("models", ["default"]), threads=2, rounds=10)
    prepared = [ten_runs(name, options.threads) for name in options.models]
    square = np.random.default_rng(1).uniform(size=(512, 512)).astype(np.float32)
    *models, yardstick = alternate(
        [*prepared, lambda: [square @ square for _ in range(TURN)]], options.rounds, per=TURN
    )
    print(f"{options.threads} threads; 512³ matmul {yardstick}")
    for name, timing in zip(options.models, models, strict=True):
        print(
            f"{name:24} {timing}   {timing.median_s / models[0].median_s:.2f} of the first, "
            f"{timing.median_s / yardstick.median_s:.1f} matmuls"
        )


def ten_runs(name: str, threads: int) -> Callable[[], object]:
    """A model, made ready to run ten times on an image of noise."""
    pipeline = depthcli.load_model(name, provider="cpu", threads=threads).pipeline
    spec = pipeline.card.input
    shape = (1, spec.colour.channels, spec.height, spec.width)
    batch = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    return lambda: [pipeline.session.run(batch) for _ in range(TURN)]


if __name__ == "__main__":
    main()
