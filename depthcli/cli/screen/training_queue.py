"""What ``depthcli train --all`` says of its runs."""

import math
from collections.abc import Sequence

from depthcli.cli.screen import console
from depthcli.jobs.train.sitting import Epoch, Sitting, Turn


class QueueScreen:
    """Lines on standard error, or JSON lines on standard output."""

    def __init__(self, *, as_json: bool, quiet: bool) -> None:
        self._as_json, self._quiet = as_json, quiet

    def print_event(self, event: Turn | Epoch | Sitting) -> None:
        """A run begins, has an epoch more, was finished before, or ends for now."""
        if self._quiet:
            return
        if isinstance(event, Epoch):
            console.out_json({"run": event.run.name, **event.line})
        elif isinstance(event, Turn):
            self._print_turn(event)
        elif self._as_json:
            console.out_json(_values(event))
        else:
            console.note(_sitting_line(event))

    def _print_turn(self, turn: Turn) -> None:
        if not self._as_json:
            finite = math.isfinite(turn.share_s)
            limit = f"for {turn.share_s / 60:.1f} min" if finite else "to its end"
            console.note(f"{turn.run.name}: training {limit}")

    def print_summary(self, sittings: Sequence[Sitting]) -> None:
        """How many are done; those that failed, even if quiet."""
        failed = [f"{s.run.name} ({s.reason})" for s in sittings if s.state == "failed"]
        finished = sum(s.state == "finished" for s in sittings)
        if not self._quiet and not self._as_json:
            rest = len(sittings) - finished - len(failed)
            more = f", {rest} to continue: run the same command again" if rest else ""
            console.note(f"{finished} of {len(sittings)} runs finished{more}")
        if failed:
            console.error(f"{len(failed)} of {len(sittings)} runs failed: {'; '.join(failed)}")


def _values(sitting: Sitting) -> dict[str, object]:
    progress = sitting.progress
    return {
        "run": sitting.run.name,
        "state": sitting.state,
        "epoch": progress.epoch,
        "epochs": sitting.run.config.optim.epochs,
        "step": progress.step,
        "minutes": round(progress.seconds / 60, 2),
        "reason": sitting.reason or None,
    }


def _sitting_line(sitting: Sitting) -> str:
    progress, run = sitting.progress, sitting.run
    reason = f" ({sitting.reason})" if sitting.reason else ""
    epochs = f"epoch {progress.epoch} of {run.config.optim.epochs}"
    return f"{run.name}: {sitting.state}{reason}, {epochs}, {progress.seconds / 60:.1f} min"
