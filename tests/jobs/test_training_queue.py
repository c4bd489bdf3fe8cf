"""A queue of runs as a program goes through it."""

from __future__ import annotations

import math
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import pytest
import torch
from helpers.rooms import write_rooms

from depthcli.datasets.training_data import open_training_data
from depthcli.errors import DatasetError, UsageError
from depthcli.jobs.train_queue import (
    EpochDone,
    QueueRequest,
    RunStarted,
    RunStatus,
    SignalForwarder,
    TrainingQueue,
    _command,
)
from depthcli.training.checkpoint import Checkpoint
from depthcli.training.methods.registry import METHODS, default_config
from depthcli.training.provenance import PlannedRun, next_share_s, provenance_of

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

SETTINGS = (
    "generator.width=4",
    "generator.blocks=1",
    "data.width=32",
    "data.height=32",
    "optim.width_discriminator=2",
    "optim.epochs_constant=100000",
)


@pytest.fixture
def request_of(tmp_path: Path) -> QueueRequest:
    """Endless runs of one method."""
    write_rooms(tmp_path / "data")
    return QueueRequest(
        data=tmp_path / "data",
        out=tmp_path / "runs",
        methods=("fastcut",),
        settings=SETTINGS,
        options=("--accelerator", "cpu", "--threads", "1", "--quiet"),
    )


def test_a_spent_budget_leaves_every_method_waiting(request_of: QueueRequest) -> None:
    request = replace(request_of, methods=(), seeds=(0, 2), minutes=0)
    queue = TrainingQueue(request)
    events = list(queue)
    assert events == list(queue.statuses)
    assert [status.run.name for status in queue.statuses] == [
        f"{method}-seed{seed}" for method in METHODS for seed in (0, 2)
    ]
    assert {status.state for status in queue.statuses} == {"waiting"}
    assert all("no time of --max-minutes" in status.reason for status in queue.statuses)
    assert not request.out.exists()


def test_a_damaged_run_failed_before_any_other_begins(request_of: QueueRequest) -> None:
    broken = request_of.out / "fastcut-seed1"
    broken.mkdir(parents=True)
    (broken / "last.ckpt").write_bytes(b"no checkpoint")
    first = next(iter(TrainingQueue(replace(request_of, seeds=(0, 1)))))
    assert isinstance(first, RunStatus)
    assert (first.run.name, first.state) == ("fastcut-seed1", "failed")
    assert "not a complete checkpoint" in first.reason


def test_who_listens_no_longer_ends_the_run_at_hand_cleanly(request_of: QueueRequest) -> None:
    options = request_of.options[:-1]
    events = iter(TrainingQueue(replace(request_of, options=options, report_epochs=True)))
    started, epoch = next(events), next(events)
    assert isinstance(started, RunStarted)
    assert isinstance(epoch, EpochDone)
    assert started.run == epoch.run
    assert epoch.line["epoch"] == 1
    events.close()  # type: ignore[attr-defined]
    assert Checkpoint.load(started.run.folder / "last.ckpt").state.step >= epoch.line["step"]


def test_what_is_wrong_for_all_is_raised_at_once(
    request_of: QueueRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(DatasetError, match="nowhere"):
        TrainingQueue(replace(request_of, data=Path("nowhere")))
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "1")
    with pytest.raises(UsageError, match="--devices instead of torchrun"):
        TrainingQueue(request_of)


def save(run: PlannedRun, seconds: float, epoch: int = 1) -> None:
    data = open_training_data(run.folder.parents[1] / "data", paired=False)
    progress = replace(provenance_of(run.config, data), seconds=seconds, epoch=epoch)
    rng = torch.get_rng_state()
    run.folder.mkdir(parents=True, exist_ok=True)
    Checkpoint(run.config, progress, {}, None, {}, {}, rng).save(run.folder / "last.ckpt")


class Simulated(TrainingQueue):
    """A queue whose runs train for hours in no time; some end with an exit code or a signal."""

    ends: dict[str, int]
    number: int | None = None
    now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s

    def _run_process(
        self, run: PlannedRun, command: Sequence[str]
    ) -> Generator[EpochDone, None, int]:
        assert str(run.folder) in command
        yield EpochDone(run, {})
        self.now_s += 10e3 + 500  # to train, and to start and end
        save(run, run.state().seconds + 10e3, 100_100 if run.config.seed == 4 else 1)
        self.signal_number = self.number
        return self.ends.get(run.name, 0)


def test_those_behind_go_first_and_all_share_what_is_left(
    request_of: QueueRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    for run in TrainingQueue(replace(request_of, seeds=(0, 1, 2))).statuses:
        save(run.run, {0: 5e3, 1: 0, 2: 300e3}[run.run.config.seed])
    queue = Simulated(replace(request_of, seeds=(0, 1, 2, 3, 4), minutes=2e3))
    queue.ends = {"fastcut-seed2": 3, "fastcut-seed3": -9, "fastcut-seed1": 143}
    monkeypatch.setattr("depthcli.jobs.train_queue.time", queue)
    events = list(queue)
    begun = [event for event in events if isinstance(event, RunStarted)]
    spent_s, left_s = [0, 0, 0, 5e3, 300e3], [120e3 - 10.5e3 * n for n in range(5)]
    shares_s = [next_share_s(spent_s[n:], left_s[n], 500 if n else 0) for n in range(5)]
    assert [(started.run.config.seed, started.share_s) for started in begun] == list(
        zip((1, 3, 4, 0, 2), shares_s, strict=True)
    )
    after = {status.run.config.seed: status for status in queue.statuses}
    assert [event for event in events if isinstance(event, RunStatus)] == [
        after[seed] for seed in (1, 3, 4, 0, 2)
    ]
    assert [(after[seed].state, after[seed].reason) for seed in range(5)] == [
        ("stopped", ""),
        ("failed", "ended by SIGTERM"),
        ("failed", "exit code 3, see its error above"),
        ("failed", "ended by SIGKILL"),
        ("finished", ""),
    ]
    assert [after[seed].progress.seconds for seed in range(5)] == [15e3, 10e3, 310e3, 10e3, 10e3]
    again = Simulated(replace(request_of, seeds=(4,)))
    assert list(again) == list(again.statuses) == [after[4]]


def test_the_last_second_is_trained(
    request_of: QueueRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    queue = Simulated(replace(request_of, minutes=0.01))
    queue.ends = {}
    monkeypatch.setattr("depthcli.jobs.train_queue.time", queue)
    started, _, status = queue
    assert isinstance(started, RunStarted)
    assert isinstance(status, RunStatus)
    assert (started.share_s, status.state) == (pytest.approx(0.6), "stopped")


def test_a_signal_ends_the_queue(request_of: QueueRequest) -> None:
    queue = Simulated(replace(request_of, seeds=(0, 1)))
    queue.ends, queue.number = {"fastcut-seed0": -15}, signal.SIGTERM
    started, _, status = queue
    assert isinstance(started, RunStarted)
    assert isinstance(status, RunStatus)
    assert (started.share_s, status.state, status.reason) == (math.inf, "stopped", "")
    assert [one.state for one in queue.statuses] == ["stopped", "waiting"]


def test_a_finished_queue_is_not_that_of_other_data(request_of: QueueRequest) -> None:
    (known,) = TrainingQueue(request_of).statuses
    save(known.run, 7, 100_100)
    assert [status.state for status in TrainingQueue(request_of)] == ["finished"]
    other = shutil.copytree(request_of.data, request_of.data.with_name("other"))
    file = str(next(other.glob("rgb/*0000.png")))
    assert cv2.imwrite(file, cv2.imread(file) // 2)
    (status,) = TrainingQueue(replace(request_of, data=other))
    assert status.state == "failed"
    assert "the data set has other files" in status.reason


def test_a_finished_queue_is_not_that_of_other_sources(
    request_of: QueueRequest, tmp_path: Path
) -> None:
    """Other pseudo labels, none, and other init weights."""
    (known,) = TrainingQueue(request_of).statuses
    write_rooms(tmp_path / "more")
    (tmp_path / "more" / "index.csv").unlink()
    save(known.run, 7, 100_100)
    weights = shutil.copy(known.run.folder / "last.ckpt", tmp_path / "first.ckpt")
    for other, reason in (
        (replace(request_of, extra=tmp_path / "more"), 'extra is "" there, "6 pseudo labels'),
        (replace(request_of, start=(Path(weights),)), 'start is "" there, "first.ckpt '),
    ):
        (status,) = TrainingQueue(other)
        assert status.state == "failed"
        assert reason in status.reason


def test_a_run_is_a_command_of_its_own() -> None:
    run = PlannedRun(replace(default_config("cut"), seed=3), Path("runs/cut-seed3"))
    plain = QueueRequest(Path("data"), Path("runs"))
    start = [sys.executable, "-m", "depthcli", "train", "cut"]
    start += ["--data", "data", "--out", "runs/cut-seed3"]
    assert _command(plain, run, math.inf) == [*start, "--set", "seed=3"]
    asked = replace(
        plain,
        preset="table",
        extra=Path("more"),
        start=(Path("a b.onnx"), Path("c.ckpt")),
        files=(Path("a.toml"), Path("b.toml")),
        settings=("x=1",),
        options=("--threads", "1"),
        report_epochs=True,
    )
    sources = ["--pseudo-labels", "more", "--init", "a b.onnx", "--init", "c.ckpt"]
    rest = "--config a.toml --config b.toml --set x=1 --set seed=3 --max-minutes 1.5000 --json"
    options = ["--threads", "1", "--preset", "table", *sources]
    assert _command(asked, run, 90) == [*start, *options, *rest.split()]


def test_settings_are_those_of_each_run(request_of: QueueRequest) -> None:
    queue = TrainingQueue(replace(request_of, methods=("cut", "fastcut"), seeds=(1, 2)))
    configs = [status.run.config for status in queue.statuses]
    assert [(one.method, one.seed) for one in configs] == [
        *(("cut", 1), ("cut", 2), ("fastcut", 1), ("fastcut", 2))
    ]
    assert {one.generator.width for one in configs} == {4}
    save(queue.statuses[0].run, 7)
    others = replace(request_of, methods=("cut",), seeds=(1,), settings=())
    (known,) = TrainingQueue(others).statuses  # a run keeps the settings that it was begun with
    assert (known.run.config, known.progress.seconds) == (configs[0], 7)


def test_a_run_s_process_tells_its_epochs_and_ends_by_a_signal(request_of: QueueRequest) -> None:
    request = replace(request_of, signals=(signal.SIGUSR1,), report_epochs=True)
    queue = TrainingQueue(request)
    run = queue.statuses[0].run
    script = "import os, time; print(int(os.getpgrp() == os.getpid()), flush=True); time.sleep(60)"
    epochs = queue._run_process(run, [sys.executable, "-c", script])
    assert next(epochs) == EpochDone(run, 1)  # type: ignore[arg-type]  # a group of its own
    os.kill(os.getpid(), signal.SIGUSR1)
    with pytest.raises(StopIteration) as ended:
        next(epochs)
    assert (ended.value.value, queue.signal_number) == (-signal.SIGUSR1, signal.SIGUSR1)
    left = TrainingQueue(request)._run_process(run, [sys.executable, "-c", script])
    next(left)
    left.close()  # ends the process, for which it waits
    silent = TrainingQueue(request_of)._run_process(
        run, [sys.executable, "-c", "raise SystemExit(7)"]
    )
    with pytest.raises(StopIteration) as ended:
        next(silent)
    assert ended.value.value == 7


def test_signals_are_handed_on_to_the_process() -> None:
    before = signal.getsignal(signal.SIGUSR1)
    command = [sys.executable, "-c", "import time; print(); time.sleep(60)"]
    with (
        SignalForwarder((signal.SIGUSR1, signal.SIGUSR2)) as forwarder,
        subprocess.Popen(command, stdout=subprocess.PIPE) as process,
    ):
        assert process.stdout is not None
        process.stdout.readline()
        os.kill(os.getpid(), signal.SIGUSR1)
        assert forwarder.number == signal.SIGUSR1
        forwarder.forward_to(process)  # one that came before goes to it now
        assert process.wait() == -signal.SIGUSR1
        os.kill(os.getpid(), signal.SIGUSR2)
        assert forwarder.number == signal.SIGUSR1
    assert signal.getsignal(signal.SIGUSR1) == before
    with (
        SignalForwarder((signal.SIGUSR2,)) as forwarder,
        subprocess.Popen(command, stdout=subprocess.PIPE) as process,
    ):
        forwarder.forward_to(process)
        assert forwarder.number is None
        os.kill(os.getpid(), signal.SIGUSR2)
        assert process.wait() == -signal.SIGUSR2
