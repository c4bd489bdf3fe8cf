"""What loop, data and logging cost: the whole run against its networks alone.

Pictures a second of ``train`` (batches, augmentation, losses, TensorBoard, callback; the log of
each epoch and its checkpoints, no validation) against bare forward, backward and optimizer steps,
with the recipe's clipping and average, of the same networks on batches made before. One after the
other in turn, in one process. Figure of merit: the overhead, bare ÷ loop − 1; it is to be at most
5 %.
Run: ``python benchmarks/training_throughput.py [--data DIR] [--rounds N]``
"""

from __future__ import annotations

import argparse
import logging
import statistics
import tempfile
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from lightning_fabric import Fabric

from depthcli.lab.datasets.base import DepthDataset, Pair
from depthcli.lab.datasets.nyu import open_nyu
from depthcli.lab.datasets.training_data import TrainingData
from depthcli.lab.training.callbacks import Callback, Callbacks
from depthcli.lab.training.data import Batches, PairStore, TrainingBatch
from depthcli.lab.training.loggers import TensorBoardLogger
from depthcli.lab.training.methods.registry import default_config
from depthcli.lab.training.presets import preset_file
from depthcli.lab.training.run import Run, fit
from depthcli.lab.training.settings import apply_overrides

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    from depthcli.lab.training.config import TrainConfig

NO_VALIDATION = ["data.holdout_every=0", "optim.epochs_constant=1000", "optim.epochs_decay=1000"]


@dataclass(frozen=True)
class Noise(DepthDataset):
    """Pairs of random pictures in memory."""

    rgb: npt.NDArray[np.uint8]  #: (H, W, 3), rolled by the position of the pair
    noise_m: npt.NDArray[np.float32]  #: (H, W), as well

    def image(self, i: int) -> npt.NDArray[np.uint8]:
        """A picture."""
        return np.roll(self.rgb, i, 1)

    def depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """Its depth."""
        return np.roll(self.noise_m, i, 1)


def noise(count: int = 866) -> Noise:
    """As many pairs as the training part of NYU has."""
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (240, 320, 3), np.uint8)
    pairs = tuple(Pair(f"{i:04d}", "room_1") for i in range(count))
    return Noise(pairs, rgb, rng.uniform(1, 9, (240, 320)).astype(np.float32))


class Stopwatch(Callback):
    """Notes when each step of the loop ends."""

    def __init__(self) -> None:
        self.ends: list[float] = []

    def on_step_end(self, *_: object) -> None:
        """Note the time."""
        self.ends.append(time.perf_counter())


def bare(run: Run, batches: list[TrainingBatch], steps: int) -> list[float]:
    """Seconds of each step of the networks and optimizers alone."""
    seconds = []
    for step in range(steps):
        start = time.perf_counter()
        for phase, optimizer in run.optimizers.items():
            terms = run.module(batches[step % len(batches)], phase)
            optimizer.zero_grad()
            run.fabric.backward(torch.stack(list(terms.values())).sum())
            if run.config.optim.clip_norm and phase == "generator":
                run.fabric.clip_gradients(run.module, optimizer, max_norm=1.0)
            optimizer.step()
        if run.average:
            run.average.update(run.method.generator, step + 1)
        if run.fabric.device.type == "cuda":
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - start)
    return seconds


def loop(config: TrainConfig, dataset: DepthDataset, out: Path, steps: int) -> list[float]:
    """Seconds of each step of a run that is continued, the ends of epochs included."""
    watch, logger = Stopwatch(), TensorBoardLogger(out, config)
    fabric = Fabric(accelerator="auto", devices=1, precision=config.precision)
    data = TrainingData(dataset, "a benchmark's pairs", None)
    fit(config, data, out, fabric, Callbacks(watch, logger), max_steps=steps + 1)
    logger.close()
    return [after - before for before, after in pairwise(watch.ends)]


def measure(name: str, config: TrainConfig, dataset: DepthDataset, steps: int, rounds: int) -> None:
    """Print one line of the table."""
    fabric = Fabric(accelerator="auto", devices=1, precision=config.precision)
    store = PairStore(dataset, range(len(dataset)), config.data)
    batches = Batches(store, config.data, config.optim.batch_size, 0, fabric.device)
    made = [batches[step] for step in range(8)]
    run = Run(config, fabric, batches.steps_per_epoch)
    alone: list[float] = []
    whole: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(rounds):
            alone += bare(run, made, steps + 1)[1:]
            whole += loop(config, dataset, Path(folder), steps)
        save_s = timed(lambda: run.save(Path(folder) / "again.ckpt"))
    bare_s, batch_s = statistics.median(alone), timed(lambda: batches[9])
    loop_s = statistics.median(whole) + save_s / (batches.steps_per_epoch * config.save_every)
    low, _, high = statistics.quantiles(alone, n=4)
    size = batches.batch_size
    print(f"{name}: bare {size / bare_s:.2f} pictures/s, loop {size / loop_s:.2f} pictures/s")
    print(
        f"  overhead {loop_s / bare_s - 1:+.1%}  (noise of a step ±{(high - low) / 2 / bare_s:.0%})"
    )
    print(f"  a batch takes {batch_s / bare_s:.1%} of a step, saving {save_s:.2f} s")


def timed(action: Callable[[], object]) -> float:
    """Median seconds of a few calls."""
    seconds = []
    for _ in range(7):
        start = time.perf_counter()
        action()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


def main() -> None:
    """Measure the shipped recipe and a small CycleGAN."""
    logging.getLogger("lightning_fabric").setLevel(logging.ERROR)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="NYU pairs; default: random pictures")
    parser.add_argument("--rounds", type=int, default=12)
    parser.add_argument("--steps", type=int, default=12)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    dataset = open_nyu(options.data) if options.data else noise()
    for method, preset in (("proposed", "bundled"), ("cyclegan", "reduced")):
        config = apply_overrides(default_config(method), [preset_file(preset)], NO_VALIDATION)
        name = f"{method} --preset {preset}"
        measure(name, config, dataset, options.steps, options.rounds)


if __name__ == "__main__":
    main()
