"""A queue of runs as a program goes through it."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import torch

sys.path.insert(0, str(Path(__file__).parents[1] / "training"))
from rooms import write_rooms

from depthcli.errors import DatasetError, UsageError
from depthcli.jobs.train.queue import Queue, QueueRequest, _words
from depthcli.jobs.train.signal_relay import SignalRelay
from depthcli.jobs.train.sitting import Epoch, Sitting, Turn
from depthcli.training.checkpoint import Checkpoint, RunProgress
from depthcli.training.methods.registry import METHODS, default_config
from depthcli.training.planned_runs import PlannedRun, next_share_s

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
    queue = Queue(request)
    events = list(queue)
    assert events == list(queue.sittings)
    assert [sitting.run.name for sitting in queue.sittings] == [
        f"{method}-seed{seed}" for method in METHODS for seed in (0, 2)
    ]
    assert {sitting.state for sitting in queue.sittings} == {"waiting"}
    assert all("no time of --max-minutes" in sitting.reason for sitting in queue.sittings)
    assert not request.out.exists()


def test_a_damaged_run_failed_before_any_other_begins(request_of: QueueRequest) -> None:
    broken = request_of.out / "fastcut-seed1"
    broken.mkdir(parents=True)
    (broken / "last.ckpt").write_bytes(b"no checkpoint")
    first = next(iter(Queue(replace(request_of, seeds=(0, 1)))))
    assert isinstance(first, Sitting)
    assert (first.run.name, first.state) == ("fastcut-seed1", "failed")
    assert "not a complete checkpoint" in first.reason


def test_who_listens_no_longer_ends_the_run_at_hand_cleanly(request_of: QueueRequest) -> None:
    options = request_of.options[:-1]
    events = iter(Queue(replace(request_of, options=options, tells_epochs=True)))
    turn, epoch = next(events), next(events)
    assert isinstance(turn, Turn)
    assert isinstance(epoch, Epoch)
    assert turn.run == epoch.run
    assert epoch.line["epoch"] == 1
    events.close()  # type: ignore[attr-defined]
    assert Checkpoint.load(turn.run.folder / "last.ckpt").progress.step >= epoch.line["step"]


def test_what_is_wrong_for_all_is_raised_at_once(
    request_of: QueueRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(DatasetError, match="nowhere"):
        Queue(replace(request_of, data=Path("nowhere")))
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "1")
    with pytest.raises(UsageError, match="--devices instead of torchrun"):
        Queue(request_of)


def save(run: PlannedRun, seconds: float, epoch: int = 1) -> None:
    progress = RunProgress(seconds=seconds, epoch=epoch)
    rng = torch.get_rng_state()
    run.folder.mkdir(parents=True, exist_ok=True)
    Checkpoint(run.config, progress, {}, None, {}, {}, rng).save(run.folder / "last.ckpt")


class Simulated(Queue):
    """A queue whose runs train for hours in no time; some end with an exit code or a signal."""

    ends: dict[str, int]
    number: int | None = None
    now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s

    def _epochs(self, run: PlannedRun, words: Sequence[str]) -> Generator[Epoch, None, int]:
        assert str(run.folder) in words
        yield Epoch(run, {})
        self.now_s += 10e3 + 500  # to train, and to start and end
        save(run, run.progress().seconds + 10e3, 100_100 if run.config.seed == 4 else 1)
        self.signal_number = self.number
        return self.ends.get(run.name, 0)


def test_those_behind_go_first_and_all_share_what_is_left(
    request_of: QueueRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    for run in Queue(replace(request_of, seeds=(0, 1, 2))).sittings:
        save(run.run, {0: 5e3, 1: 0, 2: 300e3}[run.run.config.seed])
    queue = Simulated(replace(request_of, seeds=(0, 1, 2, 3, 4), minutes=2e3))
    queue.ends = {"fastcut-seed2": 3, "fastcut-seed3": -9}
    monkeypatch.setattr("depthcli.jobs.train.queue.time", queue)
    events = list(queue)
    turns = [event for event in events if isinstance(event, Turn)]
    spent_s, left_s = [0, 0, 0, 5e3, 300e3], [120e3 - 10.5e3 * n for n in range(5)]
    shares_s = [next_share_s(spent_s[n:], left_s[n], 500 if n else 0) for n in range(5)]
    assert [(turn.run.config.seed, turn.share_s) for turn in turns] == list(
        zip((1, 3, 4, 0, 2), shares_s, strict=True)
    )
    after = {sitting.run.config.seed: sitting for sitting in queue.sittings}
    assert [event for event in events if isinstance(event, Sitting)] == [
        after[seed] for seed in (1, 3, 4, 0, 2)
    ]
    assert [(after[seed].state, after[seed].reason) for seed in range(5)] == [
        ("stopped", ""),
        ("stopped", ""),
        ("failed", "exit code 3, see its error above"),
        ("failed", "ended by signal 9"),
        ("finished", ""),
    ]
    assert [after[seed].progress.seconds for seed in range(5)] == [15e3, 10e3, 310e3, 10e3, 10e3]
    again = Simulated(replace(request_of, seeds=(4,)))
    assert list(again) == list(again.sittings) == [after[4]]


def test_the_last_second_is_trained(
    request_of: QueueRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    queue = Simulated(replace(request_of, minutes=0.01))
    queue.ends = {}
    monkeypatch.setattr("depthcli.jobs.train.queue.time", queue)
    turn, _, sitting = queue
    assert isinstance(turn, Turn)
    assert isinstance(sitting, Sitting)
    assert (turn.share_s, sitting.state) == (pytest.approx(0.6), "stopped")


def test_a_signal_ends_the_queue(request_of: QueueRequest) -> None:
    queue = Simulated(replace(request_of, seeds=(0, 1)))
    queue.ends, queue.number = {"fastcut-seed0": -15}, signal.SIGTERM
    turn, _, sitting = queue
    assert isinstance(turn, Turn)
    assert isinstance(sitting, Sitting)
    assert (turn.share_s, sitting.state, sitting.reason) == (math.inf, "stopped", "")
    assert [one.state for one in queue.sittings] == ["stopped", "waiting"]


def test_a_run_is_a_command_of_its_own() -> None:
    run = PlannedRun(replace(default_config("cut"), seed=3), Path("runs/cut-seed3"))
    plain = QueueRequest(Path("data"), Path("runs"))
    start = [sys.executable, "-m", "depthcli", "train", "cut"]
    start += ["--data", "data", "--out", "runs/cut-seed3"]
    assert _words(plain, run, math.inf) == [*start, "--set", "seed=3"]
    asked = replace(
        plain,
        preset="table",
        files=(Path("a.toml"), Path("b.toml")),
        settings=("x=1",),
        options=("--threads", "1"),
        tells_epochs=True,
    )
    rest = "--threads 1 --preset table --config a.toml --config b.toml --set x=1 --set seed=3"
    assert _words(asked, run, 90) == [*start, *rest.split(), "--max-minutes", "1.5000", "--json"]


def test_settings_are_those_of_each_run(request_of: QueueRequest) -> None:
    queue = Queue(replace(request_of, methods=("cut", "fastcut"), seeds=(1, 2)))
    configs = [sitting.run.config for sitting in queue.sittings]
    assert [(one.method, one.seed) for one in configs] == [
        *(("cut", 1), ("cut", 2), ("fastcut", 1), ("fastcut", 2))
    ]
    assert {one.generator.width for one in configs} == {4}
    save(queue.sittings[0].run, 7)
    others = replace(request_of, methods=("cut",), seeds=(1,), settings=())
    (known,) = Queue(others).sittings  # a run keeps the settings that it was begun with
    assert (known.run.config, known.progress.seconds) == (configs[0], 7)


def test_a_run_s_process_tells_its_epochs_and_ends_by_a_signal(request_of: QueueRequest) -> None:
    request = replace(request_of, signals=(signal.SIGUSR1,), tells_epochs=True)
    queue = Queue(request)
    run = queue.sittings[0].run
    script = "import os, time; print(int(os.getpgrp() == os.getpid()), flush=True); time.sleep(60)"
    epochs = queue._epochs(run, [sys.executable, "-c", script])
    assert next(epochs) == Epoch(run, 1)  # type: ignore[arg-type]  # a group of its own
    os.kill(os.getpid(), signal.SIGUSR1)
    with pytest.raises(StopIteration) as ended:
        next(epochs)
    assert (ended.value.value, queue.signal_number) == (-signal.SIGUSR1, signal.SIGUSR1)
    left = Queue(request)._epochs(run, [sys.executable, "-c", script])
    next(left)
    left.close()  # ends the process, for which it waits
    silent = Queue(request_of)._epochs(run, [sys.executable, "-c", "raise SystemExit(7)"])
    with pytest.raises(StopIteration) as ended:
        next(silent)
    assert ended.value.value == 7


def test_signals_are_handed_on_to_the_process() -> None:
    before = signal.getsignal(signal.SIGUSR1)
    command = [sys.executable, "-c", "import time; print(); time.sleep(60)"]
    with (
        SignalRelay((signal.SIGUSR1, signal.SIGUSR2)) as relay,
        subprocess.Popen(command, stdout=subprocess.PIPE) as process,
    ):
        assert process.stdout is not None
        process.stdout.readline()
        os.kill(os.getpid(), signal.SIGUSR1)
        assert relay.number == signal.SIGUSR1
        relay.to(process)  # one that came before goes to it now
        assert process.wait() == -signal.SIGUSR1
        os.kill(os.getpid(), signal.SIGUSR2)
        assert relay.number == signal.SIGUSR1
    assert signal.getsignal(signal.SIGUSR1) == before
    with (
        SignalRelay((signal.SIGUSR2,)) as relay,
        subprocess.Popen(command, stdout=subprocess.PIPE) as process,
    ):
        relay.to(process)
        assert relay.number is None
        os.kill(os.getpid(), signal.SIGUSR2)
        assert process.wait() == -signal.SIGUSR2
