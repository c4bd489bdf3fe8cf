"""Several methods and seeds, trained one after another under one time budget.

Every run is a process of its own, ``depthcli train`` for one method: a method that fails, even one
that the system kills for its memory, does not take the others with it.
"""

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from depthcli.datasets.training_data import open_training_data
from depthcli.errors import CheckpointError, UsageError
from depthcli.jobs.train.signal_relay import SignalRelay
from depthcli.jobs.train.sitting import Epoch, Sitting, Turn, failed_sitting, looked_up
from depthcli.training.methods.table import METHODS
from depthcli.training.planned_runs import PlannedRun, next_share_s, plan_runs
from depthcli.training.resolve import resolve_config

_NO_TIME = "no time of --max-minutes was left for it; give more minutes"


@dataclass(frozen=True, slots=True)
class QueueRequest:
    """What is trained."""

    #: the data set, as :func:`~depthcli.datasets.training_data.open_training_data` takes it
    data: Path
    out: Path  #: receives a folder for each run, ``METHOD-seedK``; runs in it are continued
    methods: tuple[str, ...] = ()  #: by name; all if there are none
    #: one run of each method for each of them; the settings' seed if there are none
    seeds: tuple[int, ...] = ()
    preset: str | None = None  #: name of a preset
    files: tuple[Path, ...] = ()  #: of differences
    settings: tuple[str, ...] = ()  #: ``a.b=c``
    minutes: float = math.inf  #: wall-clock minutes of all runs together
    options: tuple[str, ...] = ()  #: further words of ``depthcli train`` that every run gets
    tells_epochs: bool = False  #: also yield each epoch of a run
    #: those that end the run at hand, with a checkpoint, and all others
    signals: tuple[signal.Signals, ...] = ()


class Queue:
    """Trains runs one after another, those that were trained least first, as it is iterated over.

    ``signal_number`` is the signal that ended it, or None.

    Raises:
        UsageError: a method or setting is wrong, or ``torchrun`` started this process.
        DatasetError: the data set cannot be used.
    """

    def __init__(self, request: QueueRequest) -> None:
        self._request = request
        self._overhead_s = 0.0  # of the run before: starting, reading data, validating at the end
        self.signal_number: int | None = None
        self._sittings = {run.name: looked_up(run) for run in _planned(request)}

    @property
    def sittings(self) -> tuple[Sitting, ...]:
        """What became of every run so far, in the order of the request."""
        return tuple(self._sittings.values())

    def __iter__(self) -> Iterator[Turn | Epoch | Sitting]:
        ends = time.monotonic() + 60 * self._request.minutes
        yield from (sitting for sitting in self.sittings if sitting.state != "waiting")
        waiting = [sitting for sitting in self.sittings if sitting.state == "waiting"]
        while waiting and self.signal_number is None:
            waiting.sort(key=lambda sitting: sitting.progress.seconds)
            spent_s = [sitting.progress.seconds for sitting in waiting]
            share_s = next_share_s(spent_s, ends - time.monotonic(), self._overhead_s)
            if share_s <= 0:
                yield from (self._noted(replace(s, reason=_NO_TIME)) for s in waiting)
                break
            before, started = waiting.pop(0), time.monotonic()
            after = yield from self._train(before.run, share_s)
            trained_s = after.progress.seconds - before.progress.seconds
            self._overhead_s = max(0.0, time.monotonic() - started - trained_s)
            yield self._noted(after)

    def _noted(self, sitting: Sitting) -> Sitting:
        self._sittings[sitting.run.name] = sitting
        return sitting

    def _train(self, run: PlannedRun, share_s: float) -> Generator[Turn | Epoch, None, Sitting]:
        yield Turn(run, share_s)
        code = yield from self._epochs(run, _words(self._request, run, share_s))
        if code and self.signal_number is None:
            return failed_sitting(run, _meaning(code))
        return looked_up(run, "stopped")

    def _epochs(self, run: PlannedRun, words: Sequence[str]) -> Generator[Epoch, None, int]:
        """Wait for a run's process; its exit code."""
        pipe = subprocess.PIPE if self._request.tells_epochs else None
        relay = SignalRelay(self._request.signals)
        with relay, subprocess.Popen(words, stdout=pipe, process_group=0) as process:  # noqa: S603
            relay.to(process)
            try:
                for line in process.stdout or ():
                    yield Epoch(run, json.loads(line))
            except GeneratorExit:  # nobody listens any more
                process.terminate()
                raise
            code = process.wait()
        self.signal_number = relay.number
        return code


def _meaning(code: int) -> str:
    return f"ended by signal {-code}" if code < 0 else f"exit code {code}, see its error above"


def _planned(request: QueueRequest) -> list[PlannedRun]:
    """Every run; what is wrong for all of them is raised at once."""
    if "TORCHELASTIC_RUN_ID" in os.environ:
        raise UsageError("--all starts its own processes: give --devices instead of torchrun")
    seeds = [[f"seed={seed}"] for seed in request.seeds] or [[]]
    configs = [
        resolve_config(name, request.preset, request.files, [*request.settings, *seed])
        for name in request.methods or METHODS
        for seed in seeds
    ]
    data = configs[0].data
    open_training_data(
        request.data,
        paired=all(config.data.paired for config in configs),
        split=data.split,
        units_per_metre=data.units_per_metre,
    )
    return [_own_config(run, request) for run in plan_runs(configs, request.out)]


def _own_config(run: PlannedRun, request: QueueRequest) -> PlannedRun:
    """The same run, with the configuration that it was begun with."""
    settings = [*request.settings, f"seed={run.config.seed}"]
    method, files = run.config.method, request.files
    try:
        config = resolve_config(method, request.preset, files, settings, run.folder)
    except CheckpointError:
        return run  # it says the same when its turn comes, and stops no other
    return replace(run, config=config)


def _words(request: QueueRequest, run: PlannedRun, share_s: float) -> list[str]:
    """The command that trains one run."""
    words = [sys.executable, "-m", "depthcli", "train", run.config.method]
    words += ["--data", str(request.data), "--out", str(run.folder), *request.options]
    words += ["--preset", request.preset] if request.preset else []
    for file in request.files:
        words += ["--config", str(file)]
    for setting in (*request.settings, f"seed={run.config.seed}"):
        words += ["--set", setting]
    words += ["--max-minutes", f"{share_s / 60:.4f}"] if math.isfinite(share_s) else []
    return [*words, "--json"] if request.tells_epochs else words
