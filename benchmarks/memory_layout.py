"""What channels-last memory brings in training: steps per second of the methods of Table I.

Steps of ``--preset table`` on one CPU thread, on batches of noise, with the networks in
channels-last memory (as ``train`` has them) and in contiguous memory, in turns in one process.
Figure of merit: seconds of a step, contiguous ÷ channels-last (medians).
Run: ``python benchmarks/memory_layout.py [--methods cut,cyclegan] [--set NAME=VALUE] [--rounds N]``
"""

from __future__ import annotations

import argparse
import logging
import statistics
import time

import torch
from lightning_fabric import Fabric

from depthcli.training.data import TrainingBatch
from depthcli.training.methods.table import METHODS
from depthcli.training.run import Run
from depthcli.training.settings import resolve_config

STEPS = 3
LAYOUTS = {"contiguous": torch.contiguous_format, "channels-last": torch.channels_last}


def measure(method: str, settings: list[str], rounds: int) -> None:
    """Print one line of the table."""
    config = resolve_config(method, "table", [], settings)
    shape = (1, 1, config.data.height, config.data.width)
    batch = TrainingBatch(torch.rand(shape) * 2 - 1, torch.rand(shape) * 9 + 0.5)
    runs = {name: Run(config, Fabric(accelerator="cpu", devices=1), 1000) for name in LAYOUTS}
    seconds: dict[str, list[float]] = {name: [] for name in LAYOUTS}
    for name, layout in LAYOUTS.items():
        runs[name].method.to(memory_format=layout)  # type: ignore[call-overload]
        runs[name].step(batch)  # the first one also allocates
    for _ in range(rounds):
        for name, run in runs.items():
            start = time.perf_counter()
            for _ in range(STEPS):
                run.step(batch)
            seconds[name].append((time.perf_counter() - start) / STEPS)
    before_s, after_s = (statistics.median(seconds[name]) for name in LAYOUTS)
    low, _, high = statistics.quantiles(seconds["channels-last"], n=4)
    noise = (high - low) / 2 / after_s
    ratio = before_s / after_s
    print(f"{method:9} {before_s:.3f} s {after_s:.3f} s  ratio {ratio:.2f}  (noise ±{noise:.0%})")


def main() -> None:
    """Measure the methods that were asked for."""
    logging.getLogger("lightning_fabric").setLevel(logging.ERROR)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--set", action="append", default=[], dest="settings")
    parser.add_argument("--rounds", type=int, default=8)
    options = parser.parse_args()
    torch.set_num_threads(1)
    for method in options.methods.split(","):
        measure(method, options.settings, options.rounds)


if __name__ == "__main__":
    main()
