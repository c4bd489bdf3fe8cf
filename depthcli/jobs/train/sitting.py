"""What becomes of each run of a queue."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from depthcli.errors import CheckpointError
from depthcli.training.checkpoint import Progress

if TYPE_CHECKING:
    from depthcli.training.planned_runs import PlannedRun

State = Literal["finished", "stopped", "failed", "waiting"]


@dataclass(frozen=True, slots=True)
class Sitting:
    """What became of a run.

    Attributes:
        run: which.
        state: finished (all epochs), stopped (its share is used up), failed, or waiting.
        progress: how far it has come.
        reason: why it failed, or was not trained.
    """

    run: PlannedRun
    state: State
    progress: Progress
    reason: str = ""


def looked_up(run: PlannedRun, unfinished: State = "waiting") -> Sitting:
    """How far a run is."""
    try:
        progress = run.progress()
    except CheckpointError as error:
        return failed(run, str(error))
    return Sitting(run, "finished" if run.is_finished(progress) else unfinished, progress)


def failed(run: PlannedRun, reason: str) -> Sitting:
    """A run that failed."""
    try:
        progress = run.progress()
    except CheckpointError:
        progress = Progress()
    return Sitting(run, "failed", progress, reason)
