"""Model-only latency of the default model: one picture, two threads, in milliseconds.

Figure of merit: median ms a picture, beside a fixed matrix product as the machine's yardstick.
Run: ``python benchmarks/model_latency.py [MODEL] [--threads N]``
"""

from __future__ import annotations

import argparse
import os

# Threads of the yardstick would spin on, while the model is measured on the same cores.
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from timing import alternate

import depthcli


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", nargs="?")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--runs", type=int, default=60)
    options = parser.parse_args()
    pipeline = depthcli.load(options.model, provider="cpu", threads=options.threads)
    spec = pipeline.card.input
    shape = (1, spec.colour.channels, spec.height, spec.width)
    batch = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    square = np.random.default_rng(1).uniform(size=(512, 512)).astype(np.float32)
    model, yardstick = alternate(
        [lambda: pipeline.session.run(batch), lambda: square @ square], options.runs
    )
    print(f"{pipeline.card.name} {spec.width}×{spec.height}, {options.threads} threads")
    print(f"model       {model}")
    print(f"512³ matmul {yardstick}   ratio {model.median_s / yardstick.median_s:.1f}")


if __name__ == "__main__":
    main()
