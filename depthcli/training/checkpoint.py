"""Checkpoints: everything a run needs to go on exactly, and the configuration to rebuild it."""

import dataclasses
import os
from pathlib import Path
from typing import Any, Self

import torch
from torch import nn

from depthcli.core.choices import Weights
from depthcli.datasets.training_data import NYU_ASPECT, NYU_HFOV_DEG, NYU_PAPER
from depthcli.errors import CheckpointError, UsageError
from depthcli.io.storage.temporaries import temporary_beside
from depthcli.training.checkpoint_check import check_progress, check_state
from depthcli.training.config.changes import updated
from depthcli.training.config.ranges import check_range
from depthcli.training.config.schema import TrainConfig
from depthcli.training.networks.build import build_generator

_FORMAT = "depthcli-checkpoint"
_VERSION = 1


@dataclasses.dataclass(frozen=True, slots=True)
class RunProgress:
    """How far a run has come."""

    step: int = 0  #: optimisation steps done
    epoch: int = 0  #: whole epochs done
    seconds: float = 0.0  #: training time so far, all sittings together
    #: validation metrics of the last epoch by name; empty without held-out pairs
    scores: dict[str, float] = dataclasses.field(default_factory=dict)
    train_ids: tuple[str, ...] = ()  #: pairs the networks were trained on
    held_out_ids: tuple[str, ...] = ()  #: pairs they were validated on
    data: str = NYU_PAPER  #: what they are pairs of, as a model's card says it
    #: horizontal field of view of their camera in degrees; None if it is not known
    hfov_deg: float | None = NYU_HFOV_DEG
    extra: str = ""  #: what the extra pairs are; "" if there are none
    start: str = ""  #: whose weights it started from; "" if they were drawn
    aspect: float = NYU_ASPECT  #: width over height of their first picture
    #: CPU threads of the last sitting, on which the last digits depend; 0 if unknown
    threads: int = 0


@dataclasses.dataclass(frozen=True, slots=True)
class Checkpoint:
    """One saved state of a run."""

    config: TrainConfig  #: of the run
    progress: RunProgress  #: how far it had come
    method: dict[str, Any]  #: state dict of all networks
    #: state dict of the averaged generator; None if the run keeps none
    average: dict[str, Any] | None
    optimizers: dict[str, Any]  #: state dicts by phase
    extra: dict[str, Any]  #: further state of the method, such as image pools
    rng: torch.Tensor  #: state of torch's generator, (n,) uint8
    device_rng: torch.Tensor | None = None  #: state of the accelerator's generator; None on a CPU
    #: state of the loss scaler; empty for a precision without one
    precision: dict[str, Any] = dataclasses.field(default_factory=dict)
    #: ``extra``, ``rng`` and ``device_rng`` of the processes after the first
    others: list[dict[str, Any]] = dataclasses.field(default_factory=list)

    def save(self, path: Path) -> None:
        """Write to a temporary name beside ``path``, then rename: never a half file."""
        content = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        content["config"] = dataclasses.asdict(self.config)
        content["progress"] = dataclasses.asdict(self.progress)
        content |= {"format": _FORMAT, "version": _VERSION}
        try:
            with temporary_beside(path) as temporary:
                torch.save(content, temporary)
                _reach_disk(temporary)  # before the one that it replaces is gone
                temporary.replace(path)
        except (OSError, RuntimeError) as error:
            reason = str(error).partition("\n")[0]
            raise CheckpointError(
                f"cannot write {path} ({reason}): free some space; older checkpoints are kept"
            ) from error

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a checkpoint; nothing in it is executed.

        Raises:
            CheckpointError: missing, truncated, foreign, or of another version.
        """
        try:
            content = torch.load(path, map_location="cpu", weights_only=True)
        except FileNotFoundError:
            raise CheckpointError(f"no checkpoint at {path}") from None
        except Exception as error:  # what is no pickle fails in any way
            raise CheckpointError(
                f"{path} is not a whole checkpoint; use an earlier one"
            ) from error
        if not isinstance(content, dict) or content.pop("format", None) != _FORMAT:
            raise CheckpointError(f"{path} was not made by `depthcli train`")
        if content.pop("version", None) != _VERSION:
            raise CheckpointError(f"{path} is of another version; use the depthcli that made it")
        try:
            config = updated(TrainConfig(), content.pop("config"))
            progress = content.pop("progress")
            _check(path, config, progress, content)
            for name in ("train_ids", "held_out_ids"):
                progress[name] = tuple(progress[name])
            return cls(config=config, progress=RunProgress(**progress), **content)
        except UsageError as error:
            raise CheckpointError(
                f"{path} has a configuration of another version: {error}"
            ) from error
        except (AttributeError, KeyError, OverflowError, RecursionError, TypeError) as error:
            raise CheckpointError(
                f"{path} lacks parts of a checkpoint; use an earlier one"
            ) from error


def _check(
    path: Path, config: TrainConfig, progress: dict[str, Any], content: dict[str, Any]
) -> None:
    """Accept what a run can have written; networks are not yet built.

    Raises:
        CheckpointError: a value is of another type, out of range or not finite.
    """
    try:
        check_range(config)
        check_progress(progress)
        check_state("the networks", content["method"])
        if content["average"] is not None:
            check_state("the average", content["average"])
    except (UsageError, ValueError) as error:
        raise CheckpointError(f"{path} cannot be used: {error}; use an earlier one") from error


def _reach_disk(path: Path) -> None:
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def load_generator(path: Path, weights: Weights = Weights.AVERAGED) -> tuple[nn.Module, Checkpoint]:
    """The generator of a checkpoint, to evaluate: averaged, where the run keeps an average, or raw.

    Raises:
        CheckpointError: the checkpoint cannot be read or does not fit its configuration.
    """
    checkpoint = Checkpoint.load(path)
    generator = build_generator(checkpoint.config.generator)
    state = checkpoint.average if weights is Weights.AVERAGED else None
    if state is None:
        prefix = "generator."
        named = checkpoint.method.items()
        state = {k.removeprefix(prefix): v for k, v in named if k.startswith(prefix)}
    try:
        generator.load_state_dict(state)
    except RuntimeError as error:
        raise CheckpointError(f"{path} does not fit its own configuration") from error
    return generator.eval(), checkpoint
