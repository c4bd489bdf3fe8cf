"""The training loop: one for every method, from top to bottom."""

from __future__ import annotations

import math
import time
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import torch

from depthcli.datasets.splits import held_out_scenes
from depthcli.errors import OutputError, TrainingError, UsageError
from depthcli.training import metrics_log
from depthcli.training.checkpoint import Progress
from depthcli.training.config.ranges import check_batch
from depthcli.training.data.batches import Batches, PairStore
from depthcli.training.devices import any_process, first_process_first
from depthcli.training.interrupt import Interrupt
from depthcli.training.run import Run
from depthcli.training.samples import write_samples
from depthcli.training.validation import Validation

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from lightning_fabric import Fabric

    from depthcli.datasets.base import DepthDataset
    from depthcli.datasets.training_data import TrainingData
    from depthcli.training.config.schema import DataConfig, TrainConfig

CHECKPOINT = "last.ckpt"
METRICS_LOG = "metrics.jsonl"


class Watcher(Protocol):
    """Who is told how a run goes; with several processes, the first one's."""

    def step(self, progress: Progress, steps: int, losses: dict[str, float]) -> None:
        """A step of ``steps`` in all is done."""

    def epoch(self, progress: Progress) -> None:
        """An epoch is done, validated and saved."""


@dataclass(frozen=True, slots=True)
class Limits:
    """When to stop before the schedule ends.

    Attributes:
        minutes: wall-clock minutes of this sitting.
        steps: optimisation steps of this sitting.
    """

    minutes: float = math.inf
    steps: float = math.inf


def train(
    config: TrainConfig,
    data: TrainingData,
    folder: Path,
    fabric: Fabric,
    watcher: Watcher,
    limits: Limits | None = None,
    interrupt: Interrupt | None = None,
    start: Path | None = None,
) -> Progress:
    """Train until the schedule, a limit or a signal ends it; continue a folder's checkpoint.

    Args:
        config: the run; of a continued run it must be the checkpoint's.
        data: pairs; whole scenes are held out for validation.
        folder: receives checkpoint, metrics log and sample pictures.
        fabric: device, precision and processes; launched, if it has several.
        watcher: is told of each step and epoch.
        limits: stop early, cleanly, to continue later.
        interrupt: stop after the step in which a signal comes, and save; entered here.
        start: exported model or checkpoint whose weights a new run starts from.

    Returns:
        How far the run has come.

    Raises:
        CheckpointError: the folder holds another run, or a checkpoint cannot be written; the one
            before is kept.
        TrainingError: a loss is not finite, or the folder cannot be written; the last checkpoint
            is kept.
    """
    limits, interrupt = limits or Limits(), interrupt or Interrupt()
    first, dataset = fabric.is_global_zero, data.dataset
    with first_process_first(fabric):
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        train_rows, held_out = divide(dataset, config.data)
        batches = Batches(
            PairStore(dataset, train_rows, config.data),
            config.data,
            config.optim.batch_size,
            config.seed,
            fabric.device,
            fabric.global_rank,
            fabric.world_size,
            _extra_store(data, config),
        )
        check_batch(config, batches.own_size)
        validation = Validation(dataset, held_out, config) if held_out and first else None
        run = Run(config, fabric, batches.steps_per_epoch)
        run.progress = Progress(
            train_ids=tuple(dataset.ids[i] for i in train_rows),
            held_out_ids=tuple(dataset.ids[i] for i in held_out),
            data=data.title,
            hfov_deg=data.hfov_deg,
            extra=data.extra_title,
            start=run.start_from(start) if start else "",
            aspect=data.aspect,
        )
        run.resume(folder / CHECKPOINT)
        run.progress = replace(run.progress, threads=torch.get_num_threads())
        if first:
            with writing(folder):
                metrics_log.cut(folder / METRICS_LOG, run.progress.step)

    started, first_step, before_s = time.monotonic(), run.progress.step, run.progress.seconds
    with interrupt:
        while run.progress.step < run.steps:
            losses = run.step(batches[run.progress.step])
            elapsed_s = time.monotonic() - started
            run.progress = replace(
                run.progress, step=run.progress.step + 1, seconds=before_s + elapsed_s
            )
            if first:
                watcher.step(run.progress, run.steps, losses)
            epoch_ends = run.progress.step % batches.steps_per_epoch == 0
            done = run.progress.step - first_step
            ends = elapsed_s >= 60 * limits.minutes or done >= limits.steps
            stops = any_process(fabric, ends or interrupt.number is not None)
            if epoch_ends:
                run.progress = replace(run.progress, epoch=run.progress.epoch + 1)
                last = run.progress.step == run.steps
                if validation and (last or run.progress.epoch % config.validate_every == 0):
                    _validate(run, validation, folder)
                if first:
                    with writing(folder):
                        metrics_log.append(folder / METRICS_LOG, run.progress, losses)
            due = epoch_ends and run.progress.epoch % config.save_every == 0
            if due or stops or run.progress.step == run.steps:
                run.save(folder / CHECKPOINT)
            if epoch_ends and first:
                watcher.epoch(run.progress)
            if stops:
                break
    return run.progress


def _extra_store(data: TrainingData, config: TrainConfig) -> PairStore | None:
    if data.extra is None:
        return None
    if config.output.coding != "log" or config.method != "proposed":
        raise UsageError("extra pairs need the method proposed and output.coding=log")
    return PairStore(data.extra, range(len(data.extra)), config.data)


def _validate(run: Run, validation: Validation, folder: Path) -> None:
    """Score the generator on the held-out pairs, and draw some of them."""
    scores = validation.score(run.best_generator, run.fabric.device)
    run.progress = replace(run.progress, scores=dict(scores.items()))
    with writing(folder):
        write_samples(folder, run.progress.epoch, validation, run.best_generator, run.fabric)


def divide(dataset: DepthDataset, data: DataConfig) -> tuple[list[int], list[int]]:
    """Positions to train on and positions held out, whole scenes on either side."""
    if not data.holdout_every:
        return list(range(len(dataset))), []
    held_out = held_out_scenes(dataset.scenes, data.holdout_every, data.holdout_offset)
    inside = [scene in held_out for scene in dataset.scenes]
    train_rows = [i for i, held in enumerate(inside) if not held]
    return train_rows, [i for i, held in enumerate(inside) if held]


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turn a file that cannot be written into an error that says so.

    Raises:
        TrainingError: the system refuses.
    """
    try:
        yield
    except (OSError, OutputError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise TrainingError(
            f"cannot write to {folder} ({reason}): free some space or give another --out"
        ) from error
