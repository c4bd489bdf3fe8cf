"""Checkpoints: the complete state of a run, for exact resuming, with its configuration."""

import dataclasses
import os
import warnings
from pathlib import Path
from typing import Annotated, Any, Self, TypeAlias

import torch
from torch import nn

from depthcli.core.camera_ranges import HFOV_DEG
from depthcli.core.choices import Weights
from depthcli.core.validation import FieldError, Rule, merged, validated
from depthcli.datasets.training_data import NYU_ASPECT, NYU_HFOV_DEG, NYU_PAPER
from depthcli.errors import CheckpointError, UsageError
from depthcli.io.storage.regular import regular_size
from depthcli.io.storage.temporaries import temporary_beside
from depthcli.training.checkpoint_check import check_finite, check_process, check_tensors
from depthcli.training.config.ranges import check_range
from depthcli.training.config.rules import Amount, Count
from depthcli.training.config.schema import TrainConfig
from depthcli.training.networks.build import build_generator

_FORMAT = "depthcli-checkpoint"
_VERSION = 1
_FORMER_NAMES = {  # before 0.7
    "judge": "discriminator",
    "judge_depth": "depth_discriminator",
    "judge_gray": "gray_discriminator",
}
_Score: TypeAlias = Annotated[float, Rule("a number", lambda _: True, is_finite=False)]
_Aspect: TypeAlias = Annotated[float, Rule("a number above 0", lambda number: number > 0)]


@dataclasses.dataclass(frozen=True, slots=True)
class RunProgress:
    """How far a run has come."""

    step: Count = 0  #: optimization steps done
    epoch: Count = 0  #: whole epochs done
    seconds: Amount = 0.0  #: training time so far, of all sessions
    #: validation metrics after the last step by name; empty if it was not validated then
    scores: dict[str, _Score] = dataclasses.field(default_factory=dict)
    train_ids: tuple[str, ...] = ()  #: pairs the networks were trained on
    held_out_ids: tuple[str, ...] = ()  #: pairs they were validated on
    data: str = NYU_PAPER  #: name of their data set, as in model cards
    #: horizontal field of view of their camera in degrees; None if it is not known
    hfov_deg: Annotated[float, HFOV_DEG] | None = NYU_HFOV_DEG
    extra: str = ""  #: name of the extra pairs; "" if there are none
    #: those pairs, by :func:`~depthcli.training.seen_pairs.extra_pairs`; empty before 0.11
    extra_pairs: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    start: str = ""  #: origin of the initial weights; "" for a random initialization
    #: pairs that those were trained on, by :func:`~depthcli.training.seen_pairs.data_set`
    start_pairs: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    start_ids: tuple[str, ...] = ()  #: before 0.10, those of them that are of this data set
    aspect: _Aspect = NYU_ASPECT  #: width over height of their first picture
    #: :func:`~depthcli.datasets.fingerprint.data_fingerprint` of the data set and, if there are
    #: any, of the extra pairs; empty before 0.11
    fingerprints: tuple[str, ...] = ()
    #: CPU threads of the last session, on which the last digits depend; 0 if unknown
    threads: Count = 0


@dataclasses.dataclass(frozen=True, slots=True)
class Checkpoint:
    """The saved state of a run."""

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
        """Write to a temporary file beside ``path``, then rename it.

        Raises:
            CheckpointError: it cannot be written.
        """
        content = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        content["config"] = dataclasses.asdict(self.config)
        content["progress"] = dataclasses.asdict(self.progress)
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
            raise CheckpointError(
                f"cannot write {path} ({reason}): free some space; older checkpoints are kept"
            ) from error

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a checkpoint; no code in it is executed.

        Raises:
            CheckpointError: missing, truncated, foreign, or of another version.
        """
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # torch warns of files in other formats
                # A pipe or a device could be read without end.
                source = path if regular_size(path) else os.devnull
                content = torch.load(source, map_location="cpu", weights_only=True)
        except FileNotFoundError:
            raise CheckpointError(f"no checkpoint at {path}") from None
        except Exception as error:  # a file that is not a pickle can raise anything
            raise CheckpointError(
                f"{path} is not a complete checkpoint of 'depthcli train'; use another one"
            ) from error
        if not isinstance(content, dict) or content.pop("format", None) != _FORMAT:
            raise CheckpointError(f"{path} was not made by `depthcli train`")
        if content.pop("version", None) != _VERSION:
            raise CheckpointError(f"{path} was made by another version of depthcli; use that one")
        try:
            config = merged(TrainConfig(), content.pop("config", None))
        except FieldError as error:
            raise CheckpointError(
                f"{path} has a configuration of another version: {error}"
            ) from error
        try:
            check_range(config)
            content["progress"] = validated(RunProgress, content["progress"])
            saved = cls(config=config, **content)
            saved._check()
        except (FieldError, UsageError) as error:
            raise CheckpointError(f"{path} cannot be used: {error}; use an earlier one") from error
        except (AttributeError, KeyError, RuntimeError, TypeError) as error:
            raise CheckpointError(
                f"{path} lacks parts of a checkpoint; use an earlier one"
            ) from error
        named = {_present_name(key): tensor for key, tensor in saved.method.items()}
        return dataclasses.replace(saved, method=named)

    def _check(self) -> None:
        """Check types and values; networks are not built yet.

        Raises:
            FieldError: a value is of another type or not finite.
        """
        check_tensors("the networks", self.method)
        if self.average is not None:
            check_tensors("the average", self.average)
        check_finite("the optimizers", self.optimizers)
        check_finite("the loss scaler", self.precision)
        own = {"rng": self.rng, "device_rng": self.device_rng, "extra": self.extra}
        for process in [own, *self.others]:
            check_process(process)


def _present_name(key: str) -> str:
    """A key of the networks' state dict as it is named now."""
    network, dot, rest = key.partition(".")
    return f"{_FORMER_NAMES.get(network, network)}{dot}{rest}"


def load_generator(path: Path, weights: Weights = Weights.AVERAGED) -> tuple[nn.Module, Checkpoint]:
    """The generator of a checkpoint in evaluation mode, with averaged or raw weights.

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
