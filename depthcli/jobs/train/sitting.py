"""What happens in a queue of runs, and what becomes of each."""

from dataclasses import dataclass
from typing import Any, Literal

from depthcli.errors import CheckpointError
from depthcli.training.checkpoint import RunProgress
from depthcli.training.planned_runs import PlannedRun

State = Literal["finished", "stopped", "failed", "waiting"]


@dataclass(frozen=True, slots=True)
class Sitting:
    """What became of a run."""

    run: PlannedRun  #: which
    state: State  #: finished (all epochs), stopped (its share is used up), failed, or waiting
    progress: RunProgress  #: how far it has come
    reason: str = ""  #: why it failed, or was not trained


@dataclass(frozen=True, slots=True)
class Turn:
    """A run begins."""

    run: PlannedRun  #: which
    share_s: float  #: how long it may train, seconds; may be infinite


@dataclass(frozen=True, slots=True)
class Epoch:
    """An epoch of a run is done."""

    run: PlannedRun  #: which
    line: dict[str, Any]  #: what ``depthcli train --json`` says of it


def looked_up(run: PlannedRun, unfinished: State = "waiting") -> Sitting:
    """How far a run is."""
    try:
        progress = run.progress()
    except CheckpointError as error:
        return failed_sitting(run, str(error))
    return Sitting(run, "finished" if run.is_finished(progress) else unfinished, progress)


def failed_sitting(run: PlannedRun, reason: str) -> Sitting:
    """A run that failed."""
    try:
        progress = run.progress()
    except CheckpointError:
        progress = RunProgress()
    return Sitting(run, "failed", progress, reason)
