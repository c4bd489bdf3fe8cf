"""A queue of runs as a program goes through it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "training"))
from rooms import write_rooms

from depthcli.errors import DatasetError, UsageError
from depthcli.jobs.train.queue import Queue, QueueRequest
from depthcli.jobs.train.sitting import Epoch, Sitting, Turn
from depthcli.training.checkpoint import Checkpoint
from depthcli.training.methods.registry import METHODS

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
    assert "not a whole checkpoint" in first.reason


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
