"""The training loop, the same for every method."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from lightning_fabric import Fabric

from depthcli.core.interrupt import Interrupt
from depthcli.datasets.training_data import TrainingData
from depthcli.training import metrics_log
from depthcli.training.callbacks import Callback
from depthcli.training.checkpoint import TrainState
from depthcli.training.config.schema import TrainConfig
from depthcli.training.devices import any_process, rank_zero_first
from depthcli.training.finite import check_weights
from depthcli.training.folder import CHECKPOINT, METRICS_LOG, write_errors
from depthcli.training.samples import write_samples
from depthcli.training.setup import TrainingSetup, set_up


@dataclass(frozen=True, slots=True)
class Limits:
    """When to stop before the schedule ends."""

    minutes: float = math.inf  #: wall-clock minutes after which it stops
    steps: float = math.inf  #: optimization steps after which it stops

    def reached(self, seconds: float, steps: int) -> bool:
        """Whether a session of this length has to stop."""
        return seconds >= 60 * self.minutes or steps >= self.steps


def fit(
    config: TrainConfig,
    data: TrainingData,
    folder: Path,
    fabric: Fabric,
    callback: Callback,
    limits: Limits | None = None,
    interrupt: Interrupt | None = None,
    init_weights: Sequence[Path] = (),
) -> TrainState:
    """Train until the schedule, a limit or a signal ends it; resume from the folder's checkpoint.

    Args:
        config: of the run; for a resumed run, equal to that of the checkpoint.
        data: pairs; whole scenes are held out for validation.
        folder: receives checkpoint, metrics log and sample pictures.
        fabric: device, precision and processes; launched, if it has several.
        callback: called after each step and epoch.
        limits: when to stop early; the run can be resumed.
        interrupt: entered here; after a signal, the run stops at the end of the step and saves.
        init_weights: exported models or checkpoints; a new run starts from the mean of them.

    Returns:
        How far the run has come.

    Raises:
        CheckpointError: the folder holds another run, or a checkpoint cannot be written; the one
            before is kept.
        TrainingError: a loss or a weight is not finite, or the folder cannot be written; the last
            checkpoint is kept.
    """
    limits, interrupt = limits or Limits(), interrupt or Interrupt()
    with rank_zero_first(fabric):
        setup = set_up(config, data, folder, fabric, init_weights)
    run, batches = setup.run, setup.batches
    started, before = time.monotonic(), run.state
    with interrupt:
        while run.state.step < run.steps:
            losses = run.step(batches[run.state.step])
            step, elapsed_s = run.state.step + 1, time.monotonic() - started
            seconds = before.seconds + elapsed_s
            run.state = replace(run.state, step=step, seconds=seconds, scores={})
            if fabric.is_global_zero:
                callback.on_step_end(run.state, run.steps, losses)
            over = limits.reached(elapsed_s, step - before.step) or interrupt.number is not None
            stops = any_process(fabric, over)
            epoch_ends = step % batches.steps_per_epoch == 0
            if epoch_ends:
                _end_epoch(setup, folder, losses)
            due = epoch_ends and run.state.epoch % config.save_every == 0
            if due or stops or step == run.steps:
                run.save(folder / CHECKPOINT)
            if epoch_ends and fabric.is_global_zero:
                callback.on_epoch_end(run.state)
            if stops:
                break
    return run.state


def _end_epoch(setup: TrainingSetup, folder: Path, losses: dict[str, float]) -> None:
    """Count an epoch, validate if it is due, and log it."""
    run, validation = setup.run, setup.validation
    check_weights(run.method, run.state.step)
    epoch = run.state.epoch + 1
    run.state = replace(run.state, epoch=epoch)
    due = epoch % run.config.validate_every == 0 or run.state.step == run.steps
    if validation and due:
        scores = validation.score(run.ema_generator, run.fabric.device)
        run.state = replace(run.state, scores=dict(scores.items()))
        with write_errors(folder):
            write_samples(folder, epoch, validation, run.ema_generator, run.fabric)
    if run.fabric.is_global_zero:
        with write_errors(folder):
            metrics_log.append(folder / METRICS_LOG, run.state, losses)
