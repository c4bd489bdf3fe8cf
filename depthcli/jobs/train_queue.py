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
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from depthcli.core.progress import Interrupt
from depthcli.datasets.folders import open_paired_folder
from depthcli.datasets.training_data import TrainingData, open_training_data
from depthcli.errors import SIGNAL_BASE, CheckpointError, DatasetError, ModelError, UsageError
from depthcli.jobs.train import weights_file
from depthcli.training.checkpoint import CHECKPOINT, TrainState
from depthcli.training.config import TrainConfig
from depthcli.training.initial_weights import weights_origin
from depthcli.training.methods.registry import method_class
from depthcli.training.methods.table import METHODS
from depthcli.training.provenance import PlannedRun, next_share_s, provenance_of
from depthcli.training.resolve import resolve_config

RunState = Literal["finished", "stopped", "failed", "waiting"]


@dataclass(frozen=True, slots=True)
class RunStatus:
    """Where a run stands."""

    run: PlannedRun  #: which
    state: RunState  #: finished (all epochs), stopped (its share is used up), failed, or waiting
    progress: TrainState  #: how far it has come
    reason: str = ""  #: why it failed or was not trained


@dataclass(frozen=True, slots=True)
class RunStarted:
    """A run starts."""

    run: PlannedRun  #: which
    share_s: float  #: how long it may train, seconds; may be infinite


@dataclass(frozen=True, slots=True)
class EpochDone:
    """An epoch of a run is done."""

    run: PlannedRun  #: which
    line: dict[str, Any]  #: the JSON object that ``depthcli train --json`` prints for it


def run_status(run: PlannedRun, unfinished: RunState = "waiting") -> RunStatus:
    """The status by a run's checkpoint; ``unfinished`` if epochs remain."""
    try:
        progress = run.progress()
    except CheckpointError as error:
        return failed_status(run, str(error))
    return RunStatus(run, "finished" if run.is_finished(progress) else unfinished, progress)


def failed_status(run: PlannedRun, reason: str) -> RunStatus:
    """The status of a run that failed."""
    try:
        progress = run.progress()
    except CheckpointError:
        progress = TrainState()
    return RunStatus(run, "failed", progress, reason)


class SignalForwarder(Interrupt):
    """While entered, forwards signals to a process; ``number`` is the first one.

    The process needs a process group of its own: else a terminal would signal it as well, and a
    second signal means something else than the first.
    """

    def __init__(self, signals: Iterable[signal.Signals]) -> None:
        super().__init__(*signals)
        self._process: subprocess.Popen[bytes] | None = None

    def forward_to(self, process: subprocess.Popen[bytes]) -> None:
        """Set the process; a signal received before is sent now."""
        self._process = process
        if self.number is not None:
            process.send_signal(self.number)

    def _handle(self, number: int, _frame: object) -> None:
        if self.number is None:
            self.number = number
        if self._process is not None:
            self._process.send_signal(number)


_NO_TIME = "no time of --max-minutes was left for it; give more minutes"


@dataclass(frozen=True, slots=True)
class QueueRequest:
    """Which runs are trained, and how."""

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
    pseudo_labels: Path | None = None  #: folder of additional pairs, for every run
    init_weights: tuple[Path, ...] = ()  #: models or checkpoints that every run starts from
    options: tuple[str, ...] = ()  #: further arguments of ``depthcli train`` for every run
    report_epochs: bool = False  #: also yield each epoch of a run
    #: signals that stop the current run, with a checkpoint, and the queue
    signals: tuple[signal.Signals, ...] = ()


class TrainingQueue:
    """Trains runs one after another while it is iterated over; the least trained comes first.

    ``signal_number`` is the signal that ended it, or None.

    Raises:
        UsageError: a method or setting is wrong, or ``torchrun`` started this process.
        DatasetError: the data set cannot be used.
    """

    def __init__(self, request: QueueRequest) -> None:
        self._request = request
        self._overhead_s = 0.0  # of the previous run: start, reading data, final validation
        self.signal_number: int | None = None
        self._statuses = {run.name: run_status(run) for run in _planned(request)}

    @property
    def statuses(self) -> tuple[RunStatus, ...]:
        """The status of every run so far, in the order of the request."""
        return tuple(self._statuses.values())

    def __iter__(self) -> Iterator[RunStarted | EpochDone | RunStatus]:
        ends = time.monotonic() + 60 * self._request.minutes
        yield from (status for status in self.statuses if status.state != "waiting")
        waiting = [status for status in self.statuses if status.state == "waiting"]
        while waiting and self.signal_number is None:
            waiting.sort(key=lambda status: status.progress.seconds)
            spent_s = [status.progress.seconds for status in waiting]
            share_s = next_share_s(spent_s, ends - time.monotonic(), self._overhead_s)
            if share_s <= 0:
                yield from (self._recorded(replace(s, reason=_NO_TIME)) for s in waiting)
                break
            before, started = waiting.pop(0), time.monotonic()
            after = yield from self._train(before.run, share_s)
            trained_s = after.progress.seconds - before.progress.seconds
            self._overhead_s = max(0.0, time.monotonic() - started - trained_s)
            yield self._recorded(after)

    def _recorded(self, status: RunStatus) -> RunStatus:
        self._statuses[status.run.name] = status
        return status

    def _train(
        self, run: PlannedRun, share_s: float
    ) -> Generator[RunStarted | EpochDone, None, RunStatus]:
        yield RunStarted(run, share_s)
        code = yield from self._run_process(run, _command(self._request, run, share_s))
        if code and self.signal_number is None:
            return failed_status(run, _exit_reason(code))
        return run_status(run, "stopped")

    def _run_process(
        self, run: PlannedRun, command: Sequence[str]
    ) -> Generator[EpochDone, None, int]:
        """Wait for a run's process; its exit code."""
        pipe = subprocess.PIPE if self._request.report_epochs else None
        forwarder = SignalForwarder(self._request.signals)
        with forwarder, subprocess.Popen(command, stdout=pipe, process_group=0) as process:  # noqa: S603
            forwarder.forward_to(process)
            try:
                for line in process.stdout or ():
                    yield EpochDone(run, json.loads(line))
            except GeneratorExit:  # the caller stopped iterating
                process.terminate()
                raise
            code = process.wait()
        self.signal_number = forwarder.number
        return code


def _exit_reason(code: int) -> str:
    number = code - SIGNAL_BASE if code > 0 else -code
    if number in {one.value for one in signal.Signals}:
        return f"ended by {signal.Signals(number).name}"
    return f"exit code {code}, see its error above"


def _planned(request: QueueRequest) -> list[PlannedRun]:
    """All runs; errors that concern all of them are raised here."""
    if "TORCHELASTIC_RUN_ID" in os.environ:
        raise UsageError("--all starts its own processes: give --devices instead of torchrun")
    seeds = [[f"seed={seed}"] for seed in request.seeds] or [[]]
    configs = [
        resolve_config(name, request.preset, request.files, [*request.settings, *seed])
        for name in request.methods or METHODS
        for seed in seeds
    ]
    paired = all(config.data.paired for config in configs)
    depth = any(method_class(config.method).DEPTH for config in configs)
    _training_data(request.data, configs[0], paired=paired, depth=depth)
    runs = [PlannedRun(c, request.out / f"{c.method}-seed{c.seed}") for c in configs]
    return [_with_saved_config(run, request) for run in runs]


def _training_data(path: Path, config: TrainConfig, *, paired: bool, depth: bool) -> TrainingData:
    return open_training_data(
        path,
        paired=paired,
        depth=depth,
        split=config.data.split,
        units_per_metre=config.data.units_per_metre,
    )


def _with_saved_config(run: PlannedRun, request: QueueRequest) -> PlannedRun:
    """The same run with the configuration of its checkpoint, if it has one, and facts of its data.

    Data that it cannot use are an error again when it is due.
    """
    if not (run.folder / CHECKPOINT).exists():
        return run
    settings = [*request.settings, f"seed={run.config.seed}"]
    method, files = run.config.method, request.files
    try:
        config = resolve_config(method, request.preset, files, settings, run.folder)
        depth = method_class(config.method).DEPTH
        data = _training_data(request.data, config, paired=config.data.paired, depth=depth)
        if request.pseudo_labels is not None:
            data = data.with_pseudo_labels(open_paired_folder(request.pseudo_labels))
        origin = weights_origin([weights_file(source) for source in request.init_weights])
        return replace(
            run, config=config, facts=replace(provenance_of(config, data), init_weights=origin)
        )
    except (CheckpointError, DatasetError, ModelError):
        return run  # the error comes again when this run is due, and stops no other run


def _command(request: QueueRequest, run: PlannedRun, share_s: float) -> list[str]:
    """The command that trains one run."""
    command = [sys.executable, "-m", "depthcli", "train", run.config.method]
    command += ["--data", str(request.data), "--out", str(run.folder), *request.options]
    command += ["--preset", request.preset] if request.preset else []
    command += ["--pseudo-labels", str(request.pseudo_labels)] if request.pseudo_labels else []
    for source in request.init_weights:
        command += ["--init", str(source)]
    for file in request.files:
        command += ["--config", str(file)]
    for setting in (*request.settings, f"seed={run.config.seed}"):
        command += ["--set", setting]
    command += ["--max-minutes", f"{share_s / 60:.4f}"] if math.isfinite(share_s) else []
    return [*command, "--json"] if request.report_epochs else command
