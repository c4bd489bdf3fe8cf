"""What ``depthcli train --all`` says of its runs."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from depthcli.cli.screen import console

if TYPE_CHECKING:
    from collections.abc import Sequence

    from depthcli.training.checkpoint import Progress
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


class Shown:
    """What is said about it: lines on standard error, or JSON lines on standard output."""

    def __init__(self, *, as_json: bool, quiet: bool) -> None:
        self.as_json, self.quiet = as_json, quiet

    def plan(self, sittings: Sequence[Sitting]) -> None:
        """What is there already, before anything is trained."""
        for sitting in sittings:
            if sitting.state != "waiting":
                self.sitting(sitting)

    def begin(self, run: PlannedRun, share_s: float) -> None:
        """A run begins."""
        if not self.quiet and not self.as_json:
            limit = f"for {share_s / 60:.1f} min" if math.isfinite(share_s) else "to its end"
            console.note(f"{run.name}: training {limit}")

    def line(self, name: str, line: bytes) -> None:
        """An epoch of a run."""
        if not self.quiet:
            console.out_json({"run": name, **json.loads(line)})

    def sitting(self, sitting: Sitting) -> None:
        """A run was finished before, or ends for now."""
        progress, run = sitting.progress, sitting.run
        minutes = progress.seconds / 60
        if self.as_json and not self.quiet:
            console.out_json(
                {
                    "run": run.name,
                    "state": sitting.state,
                    "epoch": progress.epoch,
                    "epochs": run.config.optim.epochs,
                    "step": progress.step,
                    "minutes": round(minutes, 2),
                    "reason": sitting.reason or None,
                }
            )
        elif not self.quiet:
            reason = f" ({sitting.reason})" if sitting.reason else ""
            epochs = f"epoch {progress.epoch} of {run.config.optim.epochs}"
            console.note(f"{run.name}: {sitting.state}{reason}, {epochs}, {minutes:.1f} min")

    def summary(self, sittings: Sequence[Sitting]) -> None:
        """How many are done; those that failed, even if quiet."""
        failed = [f"{s.run.name} ({s.reason})" for s in sittings if s.state == "failed"]
        finished = sum(s.state == "finished" for s in sittings)
        if not self.quiet and not self.as_json:
            rest = len(sittings) - finished - len(failed)
            more = f", {rest} to continue: run the same command again" if rest else ""
            console.note(f"{finished} of {len(sittings)} runs finished{more}")
        if failed:
            console.error(f"{len(failed)} of {len(sittings)} runs failed: {'; '.join(failed)}")
