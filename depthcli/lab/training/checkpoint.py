"""Checkpoints: the complete state of a run, for exact resuming, with its configuration."""

import dataclasses
import errno
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import torch
from torch import nn

from depthcli.core.validation import FieldError, merged, validated
from depthcli.errors import CheckpointError, OutputError, TrainingError, UsageError
from depthcli.io.storage.atomic import temporary_beside
from depthcli.io.storage.paths import regular_size
from depthcli.lab.options import Weights
from depthcli.lab.training.config import TrainConfig, check_config
from depthcli.lab.training.networks.build import build_network
from depthcli.lab.training.provenance import DataProvenance, TrainState

_FORMAT = "depthcli-checkpoint"
_VERSION = 2
CHECKPOINT = "last.ckpt"
BEST_CHECKPOINT = "best.ckpt"
METRICS_LOG = "metrics.jsonl"


@dataclasses.dataclass(frozen=True, slots=True)
class Checkpoint:
    """The saved state of a run."""

    config: TrainConfig  #: of the run
    state: TrainState  #: how far it had come
    provenance: DataProvenance  #: the data it is trained on
    method: dict[str, Any]  #: state dict of all networks
    ema_generator: dict[str, Any] | None  #: state dict of the averaged generator, if there is one
    optimizers: dict[str, Any]  #: state dicts by phase
    extra: dict[str, Any]  #: further state of the method, such as image pools
    rng: torch.Tensor  #: state of torch's generator, (n,) uint8
    device_rng: torch.Tensor | None = None  #: state of the accelerator's generator; None on a CPU
    #: state of the loss scaler; empty for a precision without one
    precision: dict[str, Any] = dataclasses.field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Write to a temporary file beside ``path``, then rename it."""
        content = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        for name in ("config", "state", "provenance"):
            content[name] = dataclasses.asdict(content[name])
        content |= {"format": _FORMAT, "version": _VERSION}
        try:
            with temporary_beside(path) as temporary:
                torch.save(content, temporary)
                with temporary.open("rb+") as file:
                    os.fsync(file.fileno())  # before it replaces the previous one
                temporary.replace(path)
        except (OSError, RuntimeError) as error:
            # torch's message of a failed write names no cause.
            reason = getattr(error, "strerror", None) or "not all of it reached the disk"
            advice = "free some space; older checkpoints are kept"
            raise CheckpointError(f"cannot write {path} ({reason})", advice) from error

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a checkpoint; no code in it is executed."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # torch warns of files in other formats
                regular_size(path)  # torch would wait for a pipe
                content = torch.load(path, map_location="cpu", weights_only=True)
        except FileNotFoundError:
            raise CheckpointError(f"no checkpoint at {path}") from None
        except Exception as error:  # a file that is not a pickle can raise anything
            message = f"{path} is not a complete checkpoint of 'depthcli train'"
            raise CheckpointError(message, "use another one") from error
        if not isinstance(content, dict) or content.pop("format", None) != _FORMAT:
            raise CheckpointError(f"{path} was not made by 'depthcli train'")
        if content.pop("version", None) != _VERSION:
            raise CheckpointError(f"{path} was made by another version of depthcli", "use that one")
        content.pop("others", None)  # of further processes, by 0.16 and 0.17
        try:
            content["config"] = merged(TrainConfig(), content["config"])
            check_config(content["config"])
            content["state"] = validated(TrainState, content["state"])
            content["provenance"] = validated(DataProvenance, content["provenance"])
            return cls(**content)
        except (FieldError, UsageError) as error:
            raise CheckpointError(f"{path} cannot be used: {error}", "use another one") from error
        except (AttributeError, KeyError, TypeError) as error:
            message = f"{path} lacks parts of a checkpoint"
            raise CheckpointError(message, "use another one") from error


def load_generator(path: Path, weights: Weights = Weights.AVERAGED) -> tuple[nn.Module, Checkpoint]:
    """The generator of a checkpoint in evaluation mode, with averaged or raw weights."""
    checkpoint = Checkpoint.load(path)
    config = checkpoint.config
    generator: nn.Module = build_network(config.generator, config.data.channels)
    state = checkpoint.ema_generator if weights is Weights.AVERAGED else None
    if state is None:
        parts = [(name.partition("."), tensor) for name, tensor in checkpoint.method.items()]
        state = {name: tensor for (part, _, name), tensor in parts if part == "generator"}
    try:
        generator.load_state_dict(state)
    except RuntimeError as error:
        raise CheckpointError(f"{path} does not fit its own configuration") from error
    return generator.eval(), checkpoint


@contextmanager
def write_errors(folder: Path) -> Iterator[None]:
    """Raise failed writes in the block as a TrainingError."""
    try:
        yield
    except (OSError, OutputError) as error:
        cause = error if isinstance(error, OSError) else error.__cause__
        reason = getattr(cause, "strerror", None) or str(error)
        is_full = getattr(cause, "errno", None) in {errno.ENOSPC, errno.EDQUOT}
        advice = "free some space or give another {out}" if is_full else "give another {out}"
        raise TrainingError(f"cannot write to {folder} ({reason})", advice) from error


def saved_checkpoint(folder: Path) -> Checkpoint | None:
    """The checkpoint of a folder; None if there is none."""
    path = folder / CHECKPOINT
    return Checkpoint.load(path) if path.is_file() else None
