"""The metrics log: each epoch once, whatever happened in between."""

import json
import math
import resource
from pathlib import Path

import pytest
from helpers.rooms import EFFICIENT, room_data
from hypothesis import given, settings
from hypothesis import strategies as st
from lightning_fabric import Fabric

from depthcli.training.callbacks import Callback, append_log, truncate_log
from depthcli.training.checkpoint import CHECKPOINT, METRICS_LOG, TrainState
from depthcli.training.run import Run, fit


def _steps(path: Path) -> list[int]:
    return [json.loads(line)["step"] for line in path.read_text().splitlines()]


def test_lines_beyond_the_checkpoint_are_dropped(tmp_path: Path) -> None:
    path = tmp_path / METRICS_LOG
    truncate_log(path, 0)
    assert not path.exists()
    for step in (2, 4, 6):
        append_log(path, TrainState(step=step), {"l1": 0.5})
    for step, kept in ((9, [2, 4, 6]), (6, [2, 4, 6]), (5, [2, 4]), (0, [])):
        truncate_log(path, step)
        assert _steps(path) == kept
    assert [p.name for p in tmp_path.iterdir()] == [METRICS_LOG]


def test_a_line_has_the_losses_and_scores_of_its_epoch(tmp_path: Path) -> None:
    path, scores = tmp_path / METRICS_LOG, {"rmse": 0.5, "d1": math.nan}
    append_log(path, TrainState(4, 2, 12.3456, scores), {"l1": 0.25})
    assert path.read_bytes().endswith(b"}\n")
    assert json.loads(path.read_bytes()) == {
        "epoch": 2,
        "step": 4,
        "seconds": 12.3,
        "losses": {"l1": 0.25},
        "scores": {"rmse": 0.5, "d1": None},
    }
    path.write_bytes(b'[4]\n{"epoch": 1}\n' + path.read_bytes())
    truncate_log(path, 4)
    assert _steps(path) == [4]


def test_incomplete_write_is_undone(tmp_path: Path) -> None:
    path, (soft, hard) = tmp_path / METRICS_LOG, resource.getrlimit(resource.RLIMIT_FSIZE)
    append_log(path, TrainState(step=2), {"l1": 0.5})
    before = path.read_bytes()
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 10, hard))
    try:
        with pytest.raises(OSError, match="large"):
            append_log(path, TrainState(step=4), {"l1": 0.5})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_bytes() == before


@settings(max_examples=30, deadline=None)
@given(share=st.floats(0, 1))
def test_torn_line_is_dropped_and_the_next_is_whole(
    tmp_path_factory: pytest.TempPathFactory, share: float
) -> None:
    path = tmp_path_factory.mktemp("log") / METRICS_LOG
    append_log(path, TrainState(step=2), {"l1": 0.5})
    whole = path.read_bytes()
    path.write_bytes(whole + whole[: int(share * (len(whole) - 1))])
    truncate_log(path, 2)
    append_log(path, TrainState(step=4), {"l1": 0.5})
    assert _steps(path)[0] == 2
    assert _steps(path)[-1] == 4


def test_crash_between_line_and_checkpoint_does_not_repeat_the_epoch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def crash(run: Run, path: Path) -> None:
        if run.state.step == 4:
            raise KeyboardInterrupt
        save(run, path)

    def go_on() -> None:
        fabric = Fabric(accelerator="cpu", devices=1)
        fit(EFFICIENT, room_data(), tmp_path, fabric, Callback(), max_steps=5)

    save = Run.save
    with monkeypatch.context() as patch:
        patch.setattr(Run, "save", crash)
        with pytest.raises(KeyboardInterrupt):
            go_on()
    assert _steps(tmp_path / METRICS_LOG) == [2, 4]
    go_on()
    assert _steps(tmp_path / METRICS_LOG) == [2, 4, 6]
    assert (tmp_path / CHECKPOINT).exists()
