"""Output of a training run: a bar on a terminal, a line per epoch elsewhere, or JSON."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import timedelta
from pathlib import Path

from depthcli.cli.options import ScreenOptions
from depthcli.cli.screen import console
from depthcli.errors import Message
from depthcli.lab.jobs.train import TrainResult
from depthcli.lab.metrics.depth import finite_or_none
from depthcli.lab.training.callbacks import Callback
from depthcli.lab.training.config import TrainConfig
from depthcli.lab.training.provenance import TrainState

_SHOWN = ("abs_rel", "rmse", "d1")
_TIMED_S, _LONG_S = 10, 12 * 3600


@contextmanager
def callback_for(screen: ScreenOptions, run: str | None) -> Iterator[Callback]:
    """The callback for the options and the terminal; ``run`` is a name of one of several runs."""
    if run and screen.shows_text:
        console.note(f"training {run}")
    with ExitStack() as stack:
        is_silent = screen.quiet and not screen.as_json
        yield Callback() if is_silent else EpochCallback(stack, screen, run)


def show_config(config: TrainConfig) -> None:
    """Print a configuration as TOML."""
    values = dataclasses.asdict(config)
    groups = {name: group for name, group in values.items() if isinstance(group, dict)}
    plain = {name: value for name, value in values.items() if name not in groups}
    for heading, group in {"": plain, **groups}.items():
        if heading:
            console.out(f"\n[{heading}]")
        for name, value in group.items():
            items = value.items() if isinstance(value, dict) else ()
            inline = ", ".join(f"{json.dumps(key)} = {item}" for key, item in items)
            text = f"{{{inline}}}" if isinstance(value, dict) else json.dumps(value)
            console.out(f"{name} = {text}")


def print_result(result: TrainResult, out: Path) -> None:
    """Print steps, time and checkpoint."""
    done = result.state
    steps = f"{done.step} step{'s' * (done.step != 1)}"
    best = f"; best of epoch {done.best_epoch}: best.ckpt" if done.best_epoch else ""
    console.note(f"{steps} in {done.seconds / 60:.1f} min; checkpoint in {out}{best}")


class EpochCallback(Callback):
    """Prints each epoch as a line, with a progress bar on a terminal, or as a JSON object.

    ``stack`` closes the bar; ``run`` is a name of one of several runs, for JSON.
    """

    def __init__(self, stack: ExitStack, screen: ScreenOptions, run: str | None = None) -> None:
        self._stack, self._screen, self._run = stack, screen, run
        self._steps, self._losses = 0, dict[str, float]()
        self._stage: console.Stage | None = None
        self._begun_s, self._timed, self._is_timed = time.monotonic(), 0, False

    def on_train_start(self, warnings: tuple[str, ...]) -> None:
        """Warn of what the user may not expect of data, validation and init weights."""
        console.warn_all(warnings)
        self._begun_s = time.monotonic()

    def on_step_end(self, state: TrainState, steps: int, losses: dict[str, float]) -> None:
        """Advance the bar; the time of the first step is not measured."""
        self._losses = losses
        self._say_duration(steps - state.step)
        if self._stage is None:
            progress = self._stack.enter_context(self._screen.show_progress())
            self._steps, self._stage = steps, progress.begin("training", steps, "steps")
            self._stage.skip(state.step)
        else:
            self._stage(1)

    def _say_duration(self, left: int) -> None:
        """Print once, after the steps of ten seconds, how long the others take."""
        self._timed += 1
        passed_s = time.monotonic() - self._begun_s
        if self._is_timed or passed_s < _TIMED_S or not left:
            return
        self._is_timed, left_s = True, left * passed_s / self._timed
        text = f"the {left} steps to go take about {timedelta(seconds=round(left_s))} here"
        if left_s > _LONG_S:
            advice = "use a GPU, or {preset} reduced, which takes about an hour on two CPU cores"
            console.warn(Message(text, advice))
        elif not self._screen.as_json:
            console.note(text)

    def on_epoch_end(self, state: TrainState) -> None:
        """Print scores, and the losses of the last step; as text also rate and remaining time."""
        if self._screen.as_json:
            values = dataclasses.asdict(state) | {"scores": finite_or_none(state.scores)}
            values["losses"] = self._losses
            console.out_json(values if self._run is None else {"run": self._run, **values})
            return
        losses = " ".join(f"{name} {value:.4f}" for name, value in self._losses.items())
        scores = " ".join(f"{name} {state.scores[name]:.4f}" for name in _SHOWN if state.scores)
        held_out = f"  held out: {scores}" if scores else ""
        progress = f"epoch {state.epoch}  step {state.step}/{self._steps}"
        speed = self._stage.speed() if self._stage else ""
        console.note(f"{progress}  {losses}{held_out}  {speed}".rstrip())
