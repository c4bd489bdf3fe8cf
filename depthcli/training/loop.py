"""The training loop, the same for every method."""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from lightning_fabric import Fabric

from depthcli.core.progress import Interrupt
from depthcli.datasets.training_data import TrainingData
from depthcli.errors import UsageError
from depthcli.training import callbacks, provenance
from depthcli.training.checkpoint import CHECKPOINT, METRICS_LOG, TrainState, write_errors
from depthcli.training.config import TrainConfig
from depthcli.training.data import Batches, PairStore
from depthcli.training.devices import any_process, rank_zero_first
from depthcli.training.run import Run


def fit(
    config: TrainConfig,
    data: TrainingData,
    folder: Path,
    fabric: Fabric,
    callback: callbacks.Callback,
    *,
    init_weights: Sequence[Path] = (),
    max_minutes: float = math.inf,
    max_steps: float = math.inf,
    interrupt: Interrupt | None = None,
) -> TrainState:
    """Train until the schedule, a limit or a signal ends it; resume from the folder's checkpoint.

    Args:
        config: of the run; for a resumed run, equal to that of the checkpoint.
        data: pairs; whole scenes are held out for validation.
        folder: receives checkpoint, metrics log and sample images.
        fabric: device, precision and processes; launched, if it has several.
        callback: called after each step and epoch.
        init_weights: exported models or checkpoints; a new run starts from the mean of them.
        max_minutes: wall-clock minutes after which it stops; it can be resumed.
        max_steps: steps of this session after which it stops.
        interrupt: entered here; after a signal, the run stops at the end of the step and saves.

    Returns:
        How far the run has come.

    Raises:
        CheckpointError: the folder holds another run, or a checkpoint cannot be written; the one
            before is kept.
        TrainingError: a loss or a weight is not finite, or the folder cannot be written; the last
            checkpoint is kept.
    """
    interrupt = interrupt or Interrupt()
    with rank_zero_first(fabric):
        run, batches, validation = _set_up(config, data, folder, fabric, init_weights)
    if fabric.is_global_zero:
        held_out, seen = run.provenance.held_out_ids, run.provenance.init_ids
        callback.on_train_start(
            lacks_scenes=bool(config.data.holdout_every) and not held_out,
            seen_held_out=len(provenance.common_ids(data, held_out, seen)),
        )
    started, before = time.monotonic(), run.state
    with interrupt:
        while run.state.step < run.steps:
            losses = run.step(batches[run.state.step])
            step, elapsed_s = run.state.step + 1, time.monotonic() - started
            seconds = before.seconds + elapsed_s
            run.state = replace(run.state, step=step, seconds=seconds, scores={})
            if fabric.is_global_zero:
                callback.on_step_end(run.state, run.steps, losses)
            over = elapsed_s >= 60 * max_minutes or step - before.step >= max_steps
            stops = any_process(fabric, over or interrupt.number is not None)
            epoch_ends = step % batches.steps_per_epoch == 0
            if epoch_ends:
                _end_epoch(run, validation, folder, losses)
            due = epoch_ends and run.state.epoch % config.save_every == 0
            if due or stops or step == run.steps:
                run.save(folder / CHECKPOINT)
            if epoch_ends and fabric.is_global_zero:
                callback.on_epoch_end(run.state)
            if stops:
                break
    return run.state


def _end_epoch(
    run: Run, validation: callbacks.Validation | None, folder: Path, losses: dict[str, float]
) -> None:
    """Count an epoch, validate if it is due, and log it."""
    run.check_weights()
    epoch = run.state.epoch + 1
    run.state = replace(run.state, epoch=epoch)
    due = epoch % run.config.validate_every == 0 or run.state.step == run.steps
    if validation and due:
        scores = validation.score(run.ema_generator, run.fabric.device)
        run.state = replace(run.state, scores=dict(scores.items()))
        with write_errors(folder):
            callbacks.write_samples(folder, epoch, validation, run.ema_generator, run.fabric)
    if run.fabric.is_global_zero:
        with write_errors(folder):
            callbacks.append_log(folder / METRICS_LOG, run.state, losses)


def _set_up(
    config: TrainConfig,
    data: TrainingData,
    folder: Path,
    fabric: Fabric,
    init_weights: Sequence[Path],
) -> tuple[Run, Batches, callbacks.Validation | None]:
    """Read the pairs, build the networks, and load the folder's checkpoint if there is one.

    Validation is in the process with global rank 0 only, and if there are held-out pairs.
    """
    dataset, first, labels = data.dataset, fabric.is_global_zero, data.pseudo_labels
    train_rows, held_out = provenance.train_val_split(dataset, config.data)
    found = provenance.provenance_of(config, data)
    provenance.check_pseudo_labels(data, found)
    if labels is not None and (config.output.coding != "log" or config.method != "proposed"):
        raise UsageError("pseudo labels need the method proposed and output.coding=log")
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    batches = Batches(
        PairStore(dataset, train_rows, config.data),
        config.data,
        config.optim.batch_size,
        config.seed,
        fabric.device,
        fabric.global_rank,
        fabric.world_size,
        None if labels is None else PairStore(labels, range(len(labels)), config.data),
    )
    validation = callbacks.Validation(dataset, held_out, config) if held_out and first else None
    run = Run(config, fabric, batches.steps_per_epoch)
    run.provenance = found
    if init_weights:
        run.load_init_weights(init_weights)
    run.resume(folder / CHECKPOINT)
    run.state = replace(run.state, threads=torch.get_num_threads())
    if first:
        with write_errors(folder):
            callbacks.truncate_log(folder / METRICS_LOG, run.state.step)
    return run, batches, validation
