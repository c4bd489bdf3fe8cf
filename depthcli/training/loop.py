"""The training loop: one for every method, from top to bottom."""

from __future__ import annotations

import json
import math
import time
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import torch

from depthcli.datasets.splits import held_out_scenes
from depthcli.errors import CheckpointError, TrainingError
from depthcli.training.average import WeightAverage
from depthcli.training.batches import Batches, PairStore
from depthcli.training.checkpoint import Checkpoint, Progress
from depthcli.training.methods.registry import build_method
from depthcli.training.samples import write_samples
from depthcli.training.schedule import factor
from depthcli.training.validation import Validation

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from lightning_fabric import Fabric
    from torch import Tensor, nn

    from depthcli.datasets.base import DepthDataset
    from depthcli.training.batches import Batch
    from depthcli.training.config import DataConfig, OptimConfig, TrainConfig
    from depthcli.training.methods.base import Method, Phase

CHECKPOINT = "last.ckpt"
METRICS_LOG = "metrics.jsonl"


class Watcher(Protocol):
    """Who is told how a run goes."""

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
    dataset: DepthDataset,
    folder: Path,
    fabric: Fabric,
    watcher: Watcher,
    limits: Limits | None = None,
) -> Progress:
    """Train until the schedule or a limit ends; continue if ``folder`` holds a checkpoint.

    Args:
        config: the run; of a continued run it must be the checkpoint's.
        dataset: pairs; whole scenes are held out for validation.
        folder: receives checkpoint, metrics log and sample pictures.
        fabric: device and precision.
        watcher: is told of each step and epoch.
        limits: stop early, cleanly, to continue later.

    Returns:
        How far the run has come.

    Raises:
        CheckpointError: the folder holds another run.
        TrainingError: a loss is not finite, or the folder cannot be written; the last checkpoint
            is kept.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    limits = limits or Limits()
    train_rows, held_out = divide(dataset, config.data)
    batches = Batches(
        PairStore(dataset, train_rows, config.data),
        config.data,
        config.optim.batch_size,
        config.seed,
        fabric.device,
    )
    validation = Validation(dataset, held_out, config) if held_out else None
    run = Run(config, fabric, batches.steps_per_epoch)
    run.progress = Progress(
        train_ids=tuple(dataset.ids[i] for i in train_rows),
        held_out_ids=tuple(dataset.ids[i] for i in held_out),
    )
    run.resume(folder / CHECKPOINT)

    started, first_step, before_s = time.monotonic(), run.progress.step, run.progress.seconds
    while run.progress.step < run.steps:
        losses = run.step(batches[run.progress.step])
        elapsed_s = time.monotonic() - started
        run.progress = replace(
            run.progress, step=run.progress.step + 1, seconds=before_s + elapsed_s
        )
        watcher.step(run.progress, run.steps, losses)
        epoch_ends = run.progress.step % batches.steps_per_epoch == 0
        out_of_time = elapsed_s >= 60 * limits.minutes
        stops = out_of_time or run.progress.step - first_step >= limits.steps
        if epoch_ends:
            run.progress = replace(run.progress, epoch=run.progress.epoch + 1)
            last = run.progress.step == run.steps
            if validation and (last or run.progress.epoch % config.validate_every == 0):
                scores = validation.score(run.best_generator, fabric.device)
                run.progress = replace(run.progress, scores=dict(scores.items()))
                with writing(folder):
                    write_samples(
                        folder, run.progress.epoch, validation, run.best_generator, fabric
                    )
            with writing(folder):
                log(folder / METRICS_LOG, run.progress, losses)
        if epoch_ends or stops or run.progress.step == run.steps:
            run.save(folder / CHECKPOINT)
        if epoch_ends:
            watcher.epoch(run.progress)
        if stops:
            break
    return run.progress


def divide(dataset: DepthDataset, data: DataConfig) -> tuple[list[int], list[int]]:
    """Positions to train on and positions held out, whole scenes on either side."""
    if not data.holdout_every:
        return list(range(len(dataset))), []
    held_out = held_out_scenes(dataset.scenes, data.holdout_every, data.holdout_offset)
    inside = [scene in held_out for scene in dataset.scenes]
    train_rows = [i for i, held in enumerate(inside) if not held]
    return train_rows, [i for i, held in enumerate(inside) if held]


class Run:
    """Networks, optimisers and average of one run.

    Args:
        config: the run.
        fabric: device and precision.
        steps_per_epoch: how long an epoch is.

    Attributes:
        steps: optimisation steps of the whole schedule.
        progress: how far it has come.
    """

    def __init__(self, config: TrainConfig, fabric: Fabric, steps_per_epoch: int) -> None:
        fabric.seed_everything(config.seed, verbose=False)
        self.config, self.fabric, self.steps_per_epoch = config, fabric, steps_per_epoch
        self.steps = config.optim.epochs * steps_per_epoch
        self.progress = Progress()
        self.method = build_method(config)
        self.method.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        phases = [phase for phase in self.method.phases if self.method.networks(phase)]
        optimizers = [optimizer(self.method, phase, config.optim) for phase in phases]
        self.rates = {
            phase: [group["lr"] for group in o.param_groups]
            for phase, o in zip(phases, optimizers, strict=True)
        }
        self.module, *ready = fabric.setup(self.method, *optimizers)
        self.optimizers: dict[Phase, torch.optim.Optimizer] = dict(zip(phases, ready, strict=True))
        decay = config.optim.ema
        self.average = WeightAverage(self.method.generator, decay) if decay else None

    @property
    def best_generator(self) -> nn.Module:
        """The network that is validated: the average, where there is one."""
        return self.average.network if self.average else self.method.generator

    def step(self, batch: Batch) -> dict[str, float]:
        """One optimisation step of every phase; the loss terms by name."""
        share = factor(self.config.optim, self.progress.step, self.steps_per_epoch)
        self.method.share_done = self.progress.step / self.steps
        losses: dict[str, float] = {}
        for phase, optimizer in self.optimizers.items():
            for group, rate in zip(optimizer.param_groups, self.rates[phase], strict=True):
                group["lr"] = share * rate
            terms: dict[str, Tensor] = self.module(batch, phase)
            losses |= finite(terms)
            optimizer.zero_grad()
            self.fabric.backward(torch.stack(list(terms.values())).sum())
            if self.config.optim.clip_norm and phase == "generator":
                limit = self.config.optim.clip_norm
                self.fabric.clip_gradients(self.module, optimizer, max_norm=limit)
            optimizer.step()
        if self.average:
            self.average.update(self.method.generator, self.progress.step + 1)
        return losses

    def save(self, path: Path) -> None:
        """Write a checkpoint.

        Raises:
            CheckpointError: it cannot be written; the one before is kept.
        """
        Checkpoint(
            config=self.config,
            progress=self.progress,
            method=self.method.state_dict(),
            average=self.average.network.state_dict() if self.average else None,
            optimizers={phase: o.state_dict() for phase, o in self.optimizers.items()},
            extra=self.method.extra_state(),
            rng=torch.get_rng_state(),
            device_rng=torch.cuda.get_rng_state(self._device) if self._on_cuda else None,
        ).save(path)

    def resume(self, path: Path) -> None:
        """Take up the state of a checkpoint, if there is one.

        Raises:
            CheckpointError: it belongs to another configuration or other data.
        """
        if not path.exists():
            return
        saved = Checkpoint.load(path)
        same_data = saved.progress.train_ids == self.progress.train_ids
        if saved.config != self.config or not same_data:
            raise CheckpointError(
                f"{path} belongs to another run: give another --out, or the run's own settings"
            )
        try:
            self._take_up(saved)
        except (KeyError, RuntimeError, ValueError) as error:
            raise CheckpointError(
                f"{path} does not fit the networks of its own configuration: give another --out"
            ) from error
        self.progress = saved.progress

    def _take_up(self, saved: Checkpoint) -> None:
        self.method.load_state_dict(saved.method)
        for phase, optimizer in self.optimizers.items():
            optimizer.load_state_dict(saved.optimizers[phase])
        if self.average and saved.average:
            self.average.network.load_state_dict(saved.average)
        pools = {
            name: [image.to(self._device) for image in images]
            for name, images in saved.extra.items()
        }
        self.method.load_extra_state(pools)
        torch.set_rng_state(saved.rng)
        if self._on_cuda and saved.device_rng is not None:
            torch.cuda.set_rng_state(saved.device_rng, self._device)

    @property
    def _device(self) -> torch.device:
        return self.fabric.device

    @property
    def _on_cuda(self) -> bool:
        return self._device.type == "cuda"


def optimizer(method: Method, phase: Phase, optim: OptimConfig) -> torch.optim.Optimizer:
    """AdamW over the networks of a phase, which is Adam where nothing decays."""
    networks, heads = method.networks(phase), method.heads() if optim.head_learning_rate else []
    body = [network for network in networks if network not in heads]
    groups = _groups(body, optim.weight_decay)
    for group in _groups([network for network in networks if network in heads], optim.weight_decay):
        betas = (optim.head_beta1, optim.head_beta2)
        groups.append(group | {"lr": optim.head_learning_rate, "betas": betas})
    return torch.optim.AdamW(groups, optim.learning_rate, (optim.beta1, optim.beta2))


def _groups(networks: list[nn.Module], weight_decay: float) -> list[dict[str, Any]]:
    """Kernels and matrices, which decay, and the rest, which does not."""
    weights = [w for network in networks for w in network.parameters()]
    groups: list[dict[str, Any]] = [
        {"params": [w for w in weights if w.ndim > 1], "weight_decay": weight_decay},
        {"params": [w for w in weights if w.ndim <= 1], "weight_decay": 0.0},
    ]
    return [group for group in groups if group["params"]]


def finite(terms: dict[str, Tensor]) -> dict[str, float]:
    """The terms as numbers.

    Raises:
        TrainingError: one of them is not finite; the message names it.
    """
    values = {name: float(term.detach()) for name, term in terms.items()}
    for name, value in values.items():
        if not math.isfinite(value):
            raise TrainingError(
                f"the loss term '{name}' became {value}: lower optim.learning_rate or use "
                "precision=32-true, and go on from the last checkpoint"
            )
    return values


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turn a file that cannot be written into an error that says so.

    Raises:
        TrainingError: the system refuses.
    """
    try:
        yield
    except OSError as error:
        raise TrainingError(
            f"cannot write to {folder} ({error.strerror}): free some space or give another --out"
        ) from error


def log(path: Path, progress: Progress, losses: dict[str, float]) -> None:
    """Append one line to the metrics log."""
    line = {
        "epoch": progress.epoch,
        "step": progress.step,
        "seconds": round(progress.seconds, 1),
        "losses": losses,
        "scores": finite_or_none(progress.scores),
    }
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")


def finite_or_none(scores: dict[str, float]) -> dict[str, float | None]:
    """Scores as JSON can hold them: a metric without a value is null."""
    return {name: value if math.isfinite(value) else None for name, value in scores.items()}
