"""Several runs under one time budget: how far each has come, and how long it may train."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from depthcli.training.checkpoint import Checkpoint, TrainState
from depthcli.training.config.schema import TrainConfig
from depthcli.training.folder import CHECKPOINT
from depthcli.training.provenance import (
    DataProvenance,
    config_differences,
    data_differences,
    mismatch_error,
)


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One run of several."""

    config: TrainConfig  #: what is trained
    folder: Path  #: its folder
    #: what its data and init weights give of its progress; None if they are not compared
    facts: DataProvenance | None = field(default=None, compare=False, repr=False)

    @property
    def name(self) -> str:
        """Name of its folder."""
        return self.folder.name

    def progress(self) -> TrainState:
        """How far it has come; all zero without a checkpoint.

        Raises:
            CheckpointError: the folder's checkpoint cannot be read, or has other settings or data.
        """
        path = self.folder / CHECKPOINT
        if not path.exists():
            return TrainState()
        saved = Checkpoint.load(path)
        mismatches = config_differences(saved.config, self.config)
        if self.facts:
            mismatches += data_differences(saved.provenance, self.facts)
        if mismatches:
            raise mismatch_error(path, mismatches)
        return saved.state

    def is_finished(self, progress: TrainState) -> bool:
        """Whether all epochs of the schedule are done."""
        return progress.epoch >= self.config.optim.epochs


def fair_shares_s(spent_s: Sequence[float], budget_s: float) -> tuple[float, ...]:
    """Divide a time budget, in seconds, among runs so that the least trained catch up first.

    All runs with a share above zero end at the same total; those already beyond it get none. The
    budget may be infinite; the shares add up to it.

    >>> fair_shares_s([0, 60, 300], 100)
    (80.0, 20.0, 0.0)
    """
    level = 0.0
    for count, upper in enumerate([*sorted(spent_s)[1:], float("inf")], start=1):
        level = (max(0.0, budget_s) + sum(sorted(spent_s)[:count])) / count
        if level <= upper:
            break
    return tuple(max(0.0, level - spent) for spent in spent_s)


def next_share_s(spent_s: Sequence[float], left_s: float, overhead_s: float) -> float:
    """The share of the first waiting run, in seconds, if the others get theirs; 0 if none is left.

    A run takes ``overhead_s`` besides its training: start, reading data.

    >>> next_share_s([0, 0], left_s=100, overhead_s=10)
    40.0
    """
    return fair_shares_s(spent_s, left_s - len(spent_s) * overhead_s)[0]
