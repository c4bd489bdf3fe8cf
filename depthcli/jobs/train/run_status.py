"""Events of a queue of training runs, and the status of each run."""

from dataclasses import dataclass
from typing import Any, Literal

from depthcli.errors import CheckpointError
from depthcli.training.checkpoint import TrainState
from depthcli.training.planned_runs import PlannedRun

RunState = Literal["finished", "stopped", "failed", "waiting"]


@dataclass(frozen=True, slots=True)
class RunStatus:
    """Where a run stands."""

    run: PlannedRun  #: which
    state: RunState  #: finished (all epochs), stopped (its share is used up), failed, or waiting
    progress: TrainState  #: how far it has come
    reason: str = ""  #: why it failed or was not trained


@dataclass(frozen=True, slots=True)
class RunStarted:
    """A run starts."""

    run: PlannedRun  #: which
    share_s: float  #: how long it may train, seconds; may be infinite


@dataclass(frozen=True, slots=True)
class EpochDone:
    """An epoch of a run is done."""

    run: PlannedRun  #: which
    line: dict[str, Any]  #: the JSON object that ``depthcli train --json`` prints for it


def run_status(run: PlannedRun, unfinished: RunState = "waiting") -> RunStatus:
    """The status by a run's checkpoint; ``unfinished`` if epochs remain."""
    try:
        progress = run.progress()
    except CheckpointError as error:
        return failed_status(run, str(error))
    return RunStatus(run, "finished" if run.is_finished(progress) else unfinished, progress)


def failed_status(run: PlannedRun, reason: str) -> RunStatus:
    """The status of a run that failed."""
    try:
        progress = run.progress()
    except CheckpointError:
        progress = TrainState()
    return RunStatus(run, "failed", progress, reason)
