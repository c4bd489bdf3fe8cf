"""The training loop, the same for every method."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch
from lightning_fabric import Fabric
from torch import Tensor

from depthcli.core.progress import Interrupt
from depthcli.datasets.training_data import TrainingData
from depthcli.errors import UsageError
from depthcli.training import callbacks
from depthcli.training.callbacks import Callback, Validation, write_samples
from depthcli.training.checkpoint import CHECKPOINT, METRICS_LOG, TrainState, write_errors
from depthcli.training.config import TrainConfig
from depthcli.training.data import Batches, PairStore, whole_images
from depthcli.training.devices import any_process, rank_zero_first
from depthcli.training.init_weights import pretrained_encoder, seen_by_files
from depthcli.training.methods.registry import method_class
from depthcli.training.provenance import check_pseudo_labels, provenance_of, train_val_split
from depthcli.training.run import Run

_EXAMPLES = 128  # images, by which the decoder channels of init weights are chosen


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
        folder: receives checkpoint, metrics log and sample images.
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


def _end_epoch(setup: "TrainingSetup", folder: Path, losses: dict[str, float]) -> None:
    """Count an epoch, validate if it is due, and log it."""
    run, validation = setup.run, setup.validation
    run.check_weights()
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
            callbacks.append_log(folder / METRICS_LOG, run.state, losses)


@dataclass(frozen=True, slots=True)
class TrainingSetup:
    """Everything that the training loop needs."""

    run: Run  #: networks, optimizers and progress
    batches: Batches  #: the training batches, by step
    #: the held-out pairs; None without them, and in processes after the first
    validation: Validation | None


def set_up(
    config: TrainConfig,
    data: TrainingData,
    folder: Path,
    fabric: Fabric,
    init_weights: Sequence[Path],
) -> TrainingSetup:
    """Read the pairs, build the networks, and load the folder's checkpoint if there is one.

    Arguments and errors as of :func:`fit`.
    """
    dataset, first = data.dataset, fabric.is_global_zero
    train_rows, held_out = train_val_split(dataset, config.data)
    provenance = provenance_of(config, data)
    check_pseudo_labels(data, provenance)
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    store = PairStore(dataset, train_rows, config.data)
    batches = Batches(
        store,
        config.data,
        config.optim.batch_size,
        config.seed,
        fabric.device,
        fabric.global_rank,
        fabric.world_size,
        _pseudo_label_store(data, config),
    )
    scored = held_out and first and method_class(config.method).DEPTH
    validation = Validation(dataset, held_out, config) if scored else None
    run = Run(config, fabric, batches.steps_per_epoch)
    if init_weights:
        origin = run.load_init_weights(init_weights, partial(_examples, store, config))
        ids = seen_by_files(init_weights)
        encoder = pretrained_encoder(init_weights)
        provenance = replace(provenance, init_weights=origin, init_ids=ids, encoder_weights=encoder)
    run.provenance = provenance
    run.resume(folder / CHECKPOINT)
    run.state = replace(run.state, threads=torch.get_num_threads())
    if first:
        with write_errors(folder):
            callbacks.truncate_log(folder / METRICS_LOG, run.state.step)
    return TrainingSetup(run, batches, validation)


def _examples(store: PairStore, config: TrainConfig) -> Tensor:
    """Evenly spaced training images (B, 1, H, W) in [-1, 1], without augmentation."""
    rows = torch.linspace(0, len(store) - 1, min(len(store), _EXAMPLES)).long()
    return whole_images(store, config.data, rows)


def _pseudo_label_store(data: TrainingData, config: TrainConfig) -> PairStore | None:
    if data.pseudo_labels is None:
        return None
    if config.output.coding != "log" or config.method != "proposed":
        raise UsageError("pseudo labels need the method proposed and output.coding=log")
    return PairStore(data.pseudo_labels, range(len(data.pseudo_labels)), config.data)
