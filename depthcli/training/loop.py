"""The training loop: one for every method, from top to bottom."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from lightning_fabric import Fabric

from depthcli.core.interrupt import Interrupt
from depthcli.datasets.training_data import TrainingData
from depthcli.training import metrics_log
from depthcli.training.checkpoint import RunProgress
from depthcli.training.config.schema import TrainConfig
from depthcli.training.devices import any_process, first_process_first
from depthcli.training.folder import CHECKPOINT, METRICS_LOG, writing
from depthcli.training.samples import write_samples
from depthcli.training.setup import Prepared, set_up
from depthcli.training.watchers import Watcher


@dataclass(frozen=True, slots=True)
class Limits:
    """When to stop before the schedule ends."""

    minutes: float = math.inf  #: wall-clock minutes of this sitting
    steps: float = math.inf  #: optimisation steps of this sitting

    def reached(self, seconds: float, steps: int) -> bool:
        """Whether a sitting of this length is over."""
        return seconds >= 60 * self.minutes or steps >= self.steps


def fit(
    config: TrainConfig,
    data: TrainingData,
    folder: Path,
    fabric: Fabric,
    watcher: Watcher,
    limits: Limits | None = None,
    interrupt: Interrupt | None = None,
    start: Sequence[Path] = (),
) -> RunProgress:
    """Train until the schedule, a limit or a signal ends it; continue a folder's checkpoint.

    Args:
        config: the run; of a continued run it must be the checkpoint's.
        data: pairs; whole scenes are held out for validation.
        folder: receives checkpoint, metrics log and sample pictures.
        fabric: device, precision and processes; launched, if it has several.
        watcher: is told of each step and epoch.
        limits: stop early, cleanly, to continue later.
        interrupt: stop after the step in which a signal comes, and save; entered here.
        start: exported models or checkpoints; a new run starts from the mean of their weights.

    Returns:
        How far the run has come.

    Raises:
        CheckpointError: the folder holds another run, or a checkpoint cannot be written; the one
            before is kept.
        TrainingError: a loss is not finite, or the folder cannot be written; the last checkpoint
            is kept.
    """
    limits, interrupt = limits or Limits(), interrupt or Interrupt()
    with first_process_first(fabric):
        prepared = set_up(config, data, folder, fabric, start)
    run, batches = prepared.run, prepared.batches
    started, before = time.monotonic(), run.progress
    with interrupt:
        while run.progress.step < run.steps:
            losses = run.step(batches[run.progress.step])
            step, elapsed_s = run.progress.step + 1, time.monotonic() - started
            run.progress = replace(run.progress, step=step, seconds=before.seconds + elapsed_s)
            if fabric.is_global_zero:
                watcher.step(run.progress, run.steps, losses)
            over = limits.reached(elapsed_s, step - before.step) or interrupt.number is not None
            stops = any_process(fabric, over)
            epoch_ends = step % batches.steps_per_epoch == 0
            if epoch_ends:
                _end_epoch(prepared, folder, losses)
            due = epoch_ends and run.progress.epoch % config.save_every == 0
            if due or stops or step == run.steps:
                run.save(folder / CHECKPOINT)
            if epoch_ends and fabric.is_global_zero:
                watcher.epoch(run.progress)
            if stops:
                break
    return run.progress


def _end_epoch(prepared: Prepared, folder: Path, losses: dict[str, float]) -> None:
    """Count an epoch, validate where that is due, and log it."""
    run, validation = prepared.run, prepared.validation
    epoch = run.progress.epoch + 1
    run.progress = replace(run.progress, epoch=epoch)
    due = epoch % run.config.validate_every == 0 or run.progress.step == run.steps
    if validation and due:
        scores = validation.score(run.best_generator, run.fabric.device)
        run.progress = replace(run.progress, scores=dict(scores.items()))
        with writing(folder):
            write_samples(folder, epoch, validation, run.best_generator, run.fabric)
    if run.fabric.is_global_zero:
        with writing(folder):
            metrics_log.append(folder / METRICS_LOG, run.progress, losses)
