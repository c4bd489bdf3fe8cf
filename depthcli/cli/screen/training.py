"""How a training run is shown: a bar on a terminal, a line per epoch elsewhere, or JSON."""

from __future__ import annotations

import dataclasses
import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

from depthcli.cli.screen import console
from depthcli.cli.screen.progress import drawn

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from depthcli.cli.screen.progress import Drawing, Stage
    from depthcli.training.checkpoint import Progress
    from depthcli.training.config.schema import TrainConfig
    from depthcli.training.loop import Watcher

_SHOWN = ("abs_rel", "rmse", "d1")


@contextmanager
def progress_for(*, as_json: bool, quiet: bool) -> Iterator[Watcher]:
    """The watcher that fits options and terminal."""
    if quiet:
        yield Silent()
    elif as_json:
        yield JsonLines()
    elif sys.stderr.isatty():
        with drawn(silent=False) as drawing:
            yield Lines(drawing)
    else:
        yield Lines(None)


@contextmanager
def with_board(watcher: Watcher, folder: Path, config: TrainConfig) -> Iterator[Watcher]:
    """Also write event files for TensorBoard.

    Raises:
        TrainingError: its package is not installed.
    """
    from depthcli.training.board import Board

    board = Board(folder, config)
    try:
        yield Both(watcher, board)
    finally:
        board.close()


class Both:
    """Two watchers in one."""

    def __init__(self, first: Watcher, second: Watcher) -> None:
        self._watchers = first, second

    def step(self, progress: Progress, steps: int, losses: dict[str, float]) -> None:
        """Tell both."""
        for watcher in self._watchers:
            watcher.step(progress, steps, losses)

    def epoch(self, progress: Progress) -> None:
        """Tell both."""
        for watcher in self._watchers:
            watcher.epoch(progress)


class Silent:
    """Shows nothing."""

    def step(self, progress: Progress, steps: int, losses: dict[str, float]) -> None:
        """Nothing."""

    def epoch(self, progress: Progress) -> None:
        """Nothing."""


class JsonLines(Silent):
    """One JSON object an epoch on standard output."""

    def __init__(self) -> None:
        self._losses: dict[str, float] = {}

    def step(self, progress: Progress, steps: int, losses: dict[str, float]) -> None:
        """Keep the losses until the epoch ends."""
        del progress, steps
        self._losses = losses

    def epoch(self, progress: Progress) -> None:
        """Step, seconds, scores, and the losses of the last step."""
        from depthcli.training.metrics_log import finite_or_none

        values = dataclasses.asdict(progress) | {"scores": finite_or_none(progress.scores)}
        del values["train_ids"], values["held_out_ids"]
        values["losses"] = self._losses
        console.out_json(values)


class Lines(Silent):
    """One line an epoch on standard error, under a bar where there is one."""

    def __init__(self, drawing: Drawing | None) -> None:
        self._drawing = drawing
        self._stage: Stage | None = None
        self._losses: dict[str, float] = {}
        self._started_s = time.monotonic()
        self._first_step: int | None = None
        self._steps = 0

    def step(self, progress: Progress, steps: int, losses: dict[str, float]) -> None:
        """Move the bar."""
        if self._first_step is None:
            self._first_step = progress.step - 1
            if self._drawing:
                self._stage = self._drawing.begin("training", steps, "steps")
                self._stage.skip(self._first_step)
        self._steps, self._losses = steps, losses
        if self._stage:
            self._stage(1)

    def epoch(self, progress: Progress) -> None:
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
