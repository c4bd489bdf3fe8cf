"""``depthcli train --all``: several methods and seeds, one after another, under one time budget.

Every run is a process of its own, the same command for one method: a method that fails, even one
that the system kills for its memory, does not take the others with it.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.cli.screen.training_queue import Shown, Sitting
from depthcli.cli.signals import SIGNAL_BASE
from depthcli.errors import CheckpointError, ExitCode, UsageError
from depthcli.jobs.train.signal_relay import SignalRelay

if TYPE_CHECKING:
    from collections.abc import Sequence

    import typer

    from depthcli.cli.screen.training_queue import State
    from depthcli.training.config.schema import TrainConfig
    from depthcli.training.planned_runs import PlannedRun

_OWN = {"method", "every_method", "methods", "seeds", "out", "max_minutes", "show_config"}
"""Options that are not handed on as they are."""
_NO_TIME = "no time of --max-minutes was left for it; give more minutes"


def train_all(context: typer.Context) -> int:
    """Train what the options of ``depthcli train`` name; run again to continue."""
    options = context.params
    if options["method"]:
        raise UsageError("give a METHOD, or --all or --methods, not both")
    if options["show_config"]:
        raise UsageError("--show-config shows one method: name it in place of --all or --methods")
    if options["data"] is None:
        raise UsageError("give the data set with --data")
    from depthcli.datasets.training_data import open_training_data
    from depthcli.training.planned_runs import plan_runs

    configs = _configs(options)
    # What is wrong with it for all of them ends the command at once.
    data = configs[0].data
    open_training_data(
        Path(options["data"]),
        paired=all(config.data.paired for config in configs),
        split=data.split,
        units_per_metre=data.units_per_metre,
    )
    minutes = math.inf if options["max_minutes"] is None else options["max_minutes"]
    shown = Shown(as_json=options["as_json"], quiet=options["quiet"])
    runner = _Runner(_handed_on(context), shown, 60 * minutes)
    planned = plan_runs(configs, Path(options["out"]))
    sittings = runner.train([_own_config(run, options) for run in planned])
    shown.summary(sittings)
    if runner.signal_number is not None:
        return SIGNAL_BASE + runner.signal_number
    return ExitCode.SOME_FAILED if any(s.state == "failed" for s in sittings) else ExitCode.OK


def _configs(options: dict[str, Any]) -> list[TrainConfig]:
    """The configuration of every method and seed.

    Raises:
        UsageError: a method, seed or setting is wrong, or ``torchrun`` started this process.
    """
    from depthcli.cli.commands.train import resolve_config
    from depthcli.training.methods.registry import METHODS

    if "TORCHELASTIC_RUN_ID" in os.environ:
        raise UsageError("--all starts its own processes: give --devices instead of torchrun")
    names = _listed(options["methods"]) if options["methods"] else list(METHODS)
    files = [Path(file) for file in options["config"] or ()]
    settings = options["settings"] or []
    extra: list[list[str]] = [[]]
    if options["seeds"] is not None:
        extra = [[f"seed={_seed(text)}"] for text in _listed(options["seeds"])]
    return [
        resolve_config(name, options["preset"], files, [*settings, *seed])
        for name in names
        for seed in extra
    ]


def _own_config(run: PlannedRun, options: dict[str, Any]) -> PlannedRun:
    """The same run, with the configuration that it was begun with."""
    from depthcli.cli.commands.train import resolve_config

    method, seed = run.config.method, f"seed={run.config.seed}"
    files = [Path(file) for file in options["config"] or ()]
    settings = [*(options["settings"] or ()), seed]
    try:
        config = resolve_config(method, options["preset"], files, settings, run.folder)
    except CheckpointError:
        return run  # it says the same when its turn comes, and stops no other
    return replace(run, config=config)


def _listed(text: str) -> list[str]:
    """Words between commas, each once."""
    words = list(dict.fromkeys(word.strip() for word in text.split(",") if word.strip()))
    if not words:
        raise UsageError("--methods and --seeds take a list, such as cut,proposed or 0,1")
    return words


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise UsageError(f"--seeds takes integers such as 0,1, not '{text}'")
    return int(text)


def _handed_on(context: typer.Context) -> list[str]:
    """The words for the options that each run gets as they were given."""
    words: list[str] = []
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if parameter.name in _OWN or value in (None, False, []):
            continue
        flag = max(parameter.opts, key=len)
        if value is True:
            words.append(flag)
            continue
        for item in value if isinstance(value, (list, tuple)) else [value]:
            words += [flag, str(item)]
    return words


class _Runner:
    """Trains runs one after another.

    Attributes:
        signal_number: the signal that ended it, or None.
    """

    def __init__(self, words: Sequence[str], shown: Shown, budget_s: float) -> None:
        self._words, self._shown = words, shown
        self._ends = time.monotonic() + budget_s
        self._overhead_s = 0.0  # of the run before: starting, reading data, validating at the end
        self.signal_number: int | None = None

    def train(self, runs: Sequence[PlannedRun]) -> list[Sitting]:
        """Train them all, those that were trained least first."""
        from depthcli.training.planned_runs import next_share_s

        sittings = {run.name: _looked_up(run) for run in runs}
        waiting = [s for s in sittings.values() if s.state == "waiting"]
        self._shown.plan(list(sittings.values()))
        while waiting and self.signal_number is None:
            waiting.sort(key=lambda sitting: sitting.progress.seconds)
            left_s = self._ends - time.monotonic()
            spent_s = [sitting.progress.seconds for sitting in waiting]
            share_s = next_share_s(spent_s, left_s, self._overhead_s)
            if share_s <= 0:
                self._leave(waiting, sittings)
                break
            before = waiting.pop(0)
            started = time.monotonic()
            after = self._train_one(before.run, share_s)
            trained_s = after.progress.seconds - before.progress.seconds
            self._overhead_s = max(0.0, time.monotonic() - started - trained_s)
            sittings[after.run.name] = after
            self._shown.sitting(after)
        return list(sittings.values())

    def _leave(self, waiting: Sequence[Sitting], sittings: dict[str, Sitting]) -> None:
        """Say of each run why it is not trained now."""
        for sitting in waiting:
            left = replace(sitting, reason=_NO_TIME)
            sittings[left.run.name] = left
            self._shown.sitting(left)

    def _train_one(self, run: PlannedRun, share_s: float) -> Sitting:
        words = [sys.executable, "-m", "depthcli", "train", run.config.method, *self._words]
        words += ["--out", str(run.folder), "--set", f"seed={run.config.seed}"]
        if math.isfinite(share_s):
            words += ["--max-minutes", f"{share_s / 60:.4f}"]
        self._shown.begin(run, share_s)
        code = self._wait(words, run.name)
        if code and self.signal_number is None:
            return _failed(run, _meaning(code))
        return _looked_up(run, "stopped")

    def _wait(self, words: Sequence[str], name: str) -> int:
        pipe = subprocess.PIPE if self._shown.as_json else None
        relay = SignalRelay()
        with relay, subprocess.Popen(words, stdout=pipe, process_group=0) as process:  # noqa: S603
            relay.to(process)
            if process.stdout is not None:
                for line in process.stdout:
                    self._shown.line(name, line)
            code = process.wait()
        self.signal_number = relay.number
        return code


def _looked_up(run: PlannedRun, unfinished: State = "waiting") -> Sitting:
    """How far a run is."""
    try:
        progress = run.progress()
    except CheckpointError as error:
        return _failed(run, str(error))
    return Sitting(run, "finished" if run.is_finished(progress) else unfinished, progress)


def _failed(run: PlannedRun, reason: str) -> Sitting:
    from depthcli.training.checkpoint import Progress

    try:
        progress = run.progress()
    except CheckpointError:
        progress = Progress()
    return Sitting(run, "failed", progress, reason)


def _meaning(code: int) -> str:
    return f"ended by signal {-code}" if code < 0 else f"exit code {code}, see its error above"
