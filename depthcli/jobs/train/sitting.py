"""What happens in a queue of runs, and what becomes of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from depthcli.errors import CheckpointError
from depthcli.training.checkpoint import RunProgress

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
    progress: RunProgress
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Turn:
    """A run begins.

    Attributes:
        run: which.
        share_s: how long it may train, seconds; may be infinite.
    """

    run: PlannedRun
    share_s: float


@dataclass(frozen=True, slots=True)
class Epoch:
    """An epoch of a run is done.

    Attributes:
        run: which.
        line: what ``depthcli train --json`` says of it.
    """

    run: PlannedRun
    line: dict[str, Any]


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
        progress = RunProgress()
    return Sitting(run, "failed", progress, reason)
