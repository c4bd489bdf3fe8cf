"""How a training run is shown: a bar on a terminal, a line per epoch elsewhere, or JSON."""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from depthcli.cli.screen import console
from depthcli.cli.screen.progress import drawn
from depthcli.training.metrics_log import finite_or_none
from depthcli.training.watchers import Watcher

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from depthcli.cli.screen.progress import Drawing, Stage
    from depthcli.jobs.train.run import TrainResult
    from depthcli.training.checkpoint import RunProgress
    from depthcli.training.config.schema import TrainConfig
    from depthcli.training.watchers import TrainStart

_SHOWN = ("abs_rel", "rmse", "d1")


@contextmanager
def watcher_for(*, as_json: bool, quiet: bool) -> Iterator[Watcher]:
    """The watcher that fits options and terminal."""
    with ExitStack() as stack:
        yield Watcher() if quiet else JsonLines() if as_json else Lines(stack)


def show_config(config: TrainConfig) -> None:
    """A configuration as TOML, on standard output."""
    values = dataclasses.asdict(config)
    groups = {name: group for name, group in values.items() if isinstance(group, dict)}
    _assignments({name: value for name, value in values.items() if name not in groups})
    for name, group in groups.items():
        console.out(f"\n[{name}]")
        _assignments(group)


def _assignments(values: dict[str, object]) -> None:
    for name, value in values.items():
        console.out(f"{name} = {json.dumps(value)}")


def print_result(result: TrainResult, out: Path) -> None:
    """How far the run has come, for people."""
    done = result.progress
    console.note(f"{done.step} steps in {done.seconds / 60:.1f} min; checkpoint in {out}")


class JsonLines(Watcher):
    """One JSON object an epoch on standard output."""

    def __init__(self) -> None:
        self._losses: dict[str, float] = {}

    def begin(self, start: TrainStart) -> None:
        """Warn if nothing will be validated."""
        if start.lacks_scenes:
            console.warn("too few scenes to hold one out, so nothing is validated")

    def step(self, progress: RunProgress, steps: int, losses: dict[str, float]) -> None:
        """Keep the losses until the epoch ends."""
        del progress, steps
        self._losses = losses

    def epoch(self, progress: RunProgress) -> None:
        """Step, seconds, scores, and the losses of the last step."""
        values = dataclasses.asdict(progress) | {"scores": finite_or_none(progress.scores)}
        del values["train_ids"], values["held_out_ids"]
        values["losses"] = self._losses
        console.out_json(values)


class Lines(JsonLines):
    """One line an epoch on standard error, under a bar on a terminal, which ``stack`` closes."""

    def __init__(self, stack: ExitStack) -> None:
        super().__init__()
        self._stack = stack
        self._drawing: Drawing | None = None
        self._stage: Stage | None = None
        self._started_s = time.monotonic()
        self._first_step: int | None = None
        self._steps = 0

    def begin(self, start: TrainStart) -> None:
        """Say on how many threads, and show the bar."""
        threads = start.threads
        if threads.timed and threads.count < threads.cores:
            console.note(
                f"training on {threads.count} of {threads.cores} CPU cores, as fast as more of "
                "them in a short trial; --threads sets the number"
            )
        super().begin(start)
        if sys.stderr.isatty():
            self._drawing = self._stack.enter_context(drawn(silent=False))
        self._started_s = time.monotonic()

    def step(self, progress: RunProgress, steps: int, losses: dict[str, float]) -> None:
        """Move the bar."""
        if self._first_step is None:
            self._first_step = progress.step - 1
            if self._drawing:
                self._stage = self._drawing.begin("training", steps, "steps")
                self._stage.skip(self._first_step)
        self._steps, self._losses = steps, losses
        if self._stage:
            self._stage(1)

    def epoch(self, progress: RunProgress) -> None:
        """Losses, scores, rate and time to go."""
        elapsed_s = time.monotonic() - self._started_s
        rate = (progress.step - (self._first_step or 0)) / elapsed_s
        to_go_min = (self._steps - progress.step) / rate / 60
        losses = " ".join(f"{name} {value:.4f}" for name, value in self._losses.items())
        scores = " ".join(
            f"{name} {progress.scores[name]:.4f}" for name in _SHOWN if progress.scores
        )
        console.note(
            f"epoch {progress.epoch}  step {progress.step}/{self._steps}  {losses}  "
            f"held out: {scores or 'none'}  {rate:.2f} steps/s  {to_go_min:.0f} min to go"
        )
