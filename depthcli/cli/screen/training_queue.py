"""Output of ``depthcli train --all``."""

import math
from collections.abc import Sequence

from depthcli.cli.screen import console
from depthcli.jobs.train.run_status import EpochDone, RunStarted, RunStatus


class QueueScreen:
    """Lines on standard error, or JSON lines on standard output."""

    def __init__(self, *, as_json: bool, quiet: bool) -> None:
        self._as_json, self._quiet = as_json, quiet

    def print_event(self, event: RunStarted | EpochDone | RunStatus) -> None:
        """Print the start, an epoch or the status of a run."""
        if self._quiet and not self._as_json:
            return
        if isinstance(event, EpochDone):
            console.out_json({"run": event.run.name, **event.line})
        elif isinstance(event, RunStarted):
            self._print_started(event)
        elif self._as_json:
            console.out_json(_values(event))
        else:
            console.note(_status_line(event))

    def _print_started(self, started: RunStarted) -> None:
        if not self._as_json:
            finite = math.isfinite(started.share_s)
            limit = f"for {started.share_s / 60:.1f} min" if finite else "to its end"
            console.note(f"{started.run.name}: training {limit}")

    def print_summary(self, statuses: Sequence[RunStatus]) -> None:
        """Print how many runs are finished, and those that failed, even if quiet."""
        failed = [f"{s.run.name} ({s.reason})" for s in statuses if s.state == "failed"]
        finished = sum(s.state == "finished" for s in statuses)
        all_runs = f"{len(statuses)} run{'s'[: len(statuses) - 1]}"
        if not self._quiet and not self._as_json:
            rest = len(statuses) - finished - len(failed)
            more = f", {rest} to continue: run the same command again" if rest else ""
            console.note(f"{finished} of {all_runs} finished{more}")
        if failed:
            console.error(f"{len(failed)} of {all_runs} failed: {'; '.join(failed)}")


def _values(status: RunStatus) -> dict[str, object]:
    progress = status.progress
    return {
        "run": status.run.name,
        "state": status.state,
        "epoch": progress.epoch,
        "epochs": status.run.config.optim.epochs,
        "step": progress.step,
        "minutes": round(progress.seconds / 60, 2),
        "reason": status.reason or None,
    }


def _status_line(status: RunStatus) -> str:
    progress, run = status.progress, status.run
    reason = f" ({status.reason})" if status.reason else ""
    epochs = f"epoch {progress.epoch} of {run.config.optim.epochs}"
    return f"{run.name}: {status.state}{reason}, {epochs}, {progress.seconds / 60:.1f} min"
