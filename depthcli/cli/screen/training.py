"""Output of a training run: a bar on a terminal, a line per epoch elsewhere, or JSON."""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from depthcli.cli.screen import console
from depthcli.cli.screen.progress import ProgressDisplay, Stage, show_progress
from depthcli.jobs.train import TrainResult
from depthcli.training.callbacks import Callback, finite_or_none
from depthcli.training.checkpoint import TrainState
from depthcli.training.config import TrainConfig

_SHOWN = ("abs_rel", "rmse", "d1")


@contextmanager
def callback_for(*, as_json: bool, quiet: bool, run: str | None) -> Iterator[Callback]:
    """The callback for the options and the terminal; ``run`` is a name of one of several runs."""
    if run and not (quiet or as_json):
        console.note(f"training {run}")
    with ExitStack() as stack:
        text = Callback() if quiet else TextCallback(stack)
        yield JsonCallback(run) if as_json else text


def show_config(config: TrainConfig) -> None:
    """Print a configuration as TOML."""
    values = dataclasses.asdict(config)
    groups = {name: group for name, group in values.items() if isinstance(group, dict)}
    _assignments({name: value for name, value in values.items() if name not in groups})
    for name, group in groups.items():
        console.out(f"\n[{name}]")
        _assignments(group)


def _assignments(values: dict[str, object]) -> None:
    for name, value in values.items():
        if isinstance(value, dict):
            items = ", ".join(f"{json.dumps(key)} = {one}" for key, one in value.items())
            console.out(f"{name} = {{{items}}}")
        else:
            console.out(f"{name} = {json.dumps(value)}")


def print_result(result: TrainResult, out: Path) -> None:
    """Print steps, time and checkpoint."""
    done = result.state
    steps = f"{done.step} step{'s' * (done.step != 1)}"
    best = f"; best of epoch {done.best_epoch}: best.ckpt" if done.best_epoch else ""
    console.note(f"{steps} in {done.seconds / 60:.1f} min; checkpoint in {out}{best}")


class _Reporter(Callback):
    """Warns before the first step, and stores the losses of the last one."""

    def __init__(self) -> None:
        self._losses: dict[str, float] = {}

    def on_train_start(
        self, *, lacks_scenes: bool, seen_held_out: int, warnings: tuple[str, ...]
    ) -> None:
        """Warn of what the user may not expect of data, validation and init weights."""
        console.warn_all(warnings)
        if lacks_scenes:
            console.warn("too few scenes to hold one out, so nothing is validated")
        if seen_held_out:
            seen = f"the init weights were trained on {seen_held_out} of the held-out pairs"
            console.warn(f"{seen}, so the scores are not those of new images")

    def on_step_end(self, state: TrainState, steps: int, losses: dict[str, float]) -> None:
        """Store the losses for the end of the epoch."""
        del state, steps
        self._losses = losses


class JsonCallback(_Reporter):
    """Prints one JSON object per epoch to standard output, with the name of one of several runs."""

    def __init__(self, run: str | None = None) -> None:
        super().__init__()
        self._run = run

    def on_epoch_end(self, state: TrainState) -> None:
        """Print step, seconds, scores, and the losses of the last step."""
        values = dataclasses.asdict(state) | {"scores": finite_or_none(state.scores)}
        values["losses"] = self._losses
        console.out_json(values if self._run is None else {"run": self._run, **values})


class TextCallback(_Reporter):
    """Prints one line per epoch, and on a terminal a progress bar, which ``stack`` closes."""

    def __init__(self, stack: ExitStack) -> None:
        super().__init__()
        self._stack, self._steps = stack, 0
        self._display: ProgressDisplay | None = None
        self._stage: Stage | None = None
        self._first: tuple[int, float] | None = None

    def on_train_start(
        self, *, lacks_scenes: bool, seen_held_out: int, warnings: tuple[str, ...]
    ) -> None:
        """Warn, and show the bar."""
        super().on_train_start(
            lacks_scenes=lacks_scenes, seen_held_out=seen_held_out, warnings=warnings
        )
        if sys.stderr.isatty():
            self._display = self._stack.enter_context(show_progress(silent=False))

    def on_step_end(self, state: TrainState, steps: int, losses: dict[str, float]) -> None:
        """Advance the bar."""
        if self._first is None:  # whose own time is not measured
            self._first = state.step, time.monotonic()
            if self._display:
                self._stage = self._display.begin("training", steps, "steps")
                self._stage.skip(state.step - 1)
        self._steps = steps
        super().on_step_end(state, steps, losses)
        if self._stage:
            self._stage(1)

    def on_epoch_end(self, state: TrainState) -> None:
        """Print losses, scores, rate and remaining time."""
        first, start_s = self._first or (state.step, 0.0)
        done, elapsed_s = state.step - first, time.monotonic() - start_s
        speed = ""
        if done and elapsed_s > 0:
            rate = done / elapsed_s
            to_go_min = (self._steps - state.step) / rate / 60
            speed = f"  {rate:.2f} steps/s  {to_go_min:.0f} min to go"
        losses = " ".join(f"{name} {value:.4f}" for name, value in self._losses.items())
        scores = " ".join(f"{name} {state.scores[name]:.4f}" for name in _SHOWN if state.scores)
        held_out = f"  held out: {scores}" if scores else ""
        progress = f"epoch {state.epoch}  step {state.step}/{self._steps}"
        console.note(f"{progress}  {losses}{held_out}{speed}")
