"""What loop, data and logging cost: the whole run against its networks alone.

Pictures a second of ``train`` (batches, augmentation, losses, TensorBoard, callback; the log of
each epoch and its checkpoints, no validation) against bare forward, backward and optimizer steps,
with the recipe's clipping and average, of the same networks on batches made before. One after the
other in turn, in one process. Figure of merit: the overhead, bare ÷ loop − 1; it is to be at most
5 %.
Run: ``python benchmarks/training_throughput.py NYU [--rounds N]``
"""

from __future__ import annotations

import logging
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from lightning_fabric import Fabric
from tools import Timing, alternate, parse_options

from depthcli.lab.datasets.nyu import open_nyu
from depthcli.lab.datasets.training_data import TrainingData
from depthcli.lab.training.callbacks import Callback
from depthcli.lab.training.data import Batches, PairStore, TrainingBatch
from depthcli.lab.training.loggers import TensorBoardLogger
from depthcli.lab.training.methods.registry import default_config
from depthcli.lab.training.presets import preset_file
from depthcli.lab.training.run import Run, fit
from depthcli.lab.training.settings import apply_overrides

if TYPE_CHECKING:
    from depthcli.lab.datasets.base import DepthDataset
    from depthcli.lab.training.config import TrainConfig

NO_VALIDATION = ["data.holdout_every=0", "optim.epochs_constant=1000", "optim.epochs_decay=1000"]


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
    fit(config, data, out, fabric, watch, logger, max_steps=steps + 1)
    logger.close()
    return [after - before for before, after in pairwise(watch.ends)]


def measure(name: str, config: TrainConfig, dataset: DepthDataset, steps: int, rounds: int) -> None:
    """Print one line of the table."""
    fabric = Fabric(accelerator="auto", devices=1, precision=config.precision)
    store = PairStore(dataset, range(len(dataset)), config.data)
    batches = Batches(store, config.data, config.optim.batch_size, 0, fabric.device)
    prepared = [batches[step] for step in range(8)]
    run = Run(config, fabric, batches.steps_per_epoch)
    alone: list[float] = []
    whole: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(rounds):
            alone += bare(run, prepared, steps + 1)[1:]
            whole += loop(config, dataset, Path(folder), steps)
        again = Path(folder) / "again.ckpt"
        saving, batch = alternate([lambda: run.save(again), lambda: batches[9]], 7)
    save_s, bare_s = saving.median_s, Timing(tuple(alone)).median_s
    loop_s = Timing(tuple(whole)).median_s
    loop_s += save_s / (batches.steps_per_epoch * config.save_every)
    size = batches.batch_size
    print(f"{name}: bare {size / bare_s:.2f} pictures/s, loop {size / loop_s:.2f} pictures/s")
    noise = Timing(tuple(alone)).noise
    print(f"  overhead {loop_s / bare_s - 1:+.1%}  (noise of a step ±{noise:.0%})")
    print(f"  a batch takes {batch.median_s / bare_s:.1%} of a step, saving {save_s:.2f} s")


def main() -> None:
    """Measure the shipped recipe and a small CycleGAN."""
    logging.getLogger("lightning_fabric").setLevel(logging.ERROR)
    options = parse_options(__doc__, "nyu", rounds=12, steps=12, threads=torch.get_num_threads())
    torch.set_num_threads(options.threads)
    dataset = open_nyu(options.nyu)
    for method, preset in (("proposed", "bundled"), ("cyclegan", "reduced")):
        config = apply_overrides(default_config(method), [preset_file(preset)], NO_VALIDATION)
        name = f"{method} --preset {preset}"
        measure(name, config, dataset, options.steps, options.rounds)


if __name__ == "__main__":
    main()
