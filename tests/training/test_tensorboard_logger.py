"""``depthcli train --tensorboard``, read back by TensorBoard itself."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from helpers.rooms import write_rooms
from helpers.runs import inside

SETTINGS = (
    "generator.name=efficient",
    "generator.encoder=[8,8,8,8,8]",
    "generator.decoder=[8,8,8,8]",
    "generator.depths=[1,1,1,1]",
    "data.width=64",
    "data.height=48",
    "data.holdout_every=4",
    "data.holdout_offset=1",
    "optim.batch_size=2",
    "optim.epochs_decay=2",
    "optim.warmup_steps=2",
    "validate_every=1",
)


def _train(folder: Path, *more: str) -> subprocess.CompletedProcess[str]:
    words = ["train", "proposed", "--preset", "default"]
    words += ["--data", "data", "--out", "run", "--accelerator", "cpu", "--threads", "1"]
    words += ["--tensorboard", *more]
    for setting in SETTINGS:
        words += ["--set", setting]
    return inside(folder, *words)


def _events(folder: Path) -> Any:
    from tensorboard.backend.event_processing.event_accumulator import (  # noqa: PLC0415
        EventAccumulator,
    )

    return EventAccumulator(str(folder)).Reload()


def test_tensorboard_has_every_step_once_though_a_killed_run_repeats_some(tmp_path: Path) -> None:
    write_rooms(tmp_path / "data")
    assert _train(tmp_path, "--max-minutes", "0").returncode == 0
    early = (tmp_path / "run" / "last.ckpt").read_bytes()
    for _ in range(2):
        (tmp_path / "run" / "last.ckpt").write_bytes(early)
        done = _train(tmp_path, "--json")
        assert done.returncode == 0, done.stderr
        assert len(done.stdout.splitlines()) == 2  # whoever else is told, is told as well
    events = _events(tmp_path / "run" / "tensorboard")
    assert set(events.Tags()["scalars"]) > {"loss/l1", "loss/gradient", "held_out/d1"}
    assert [e.step for e in events.Scalars("loss/l1")] == [1, 2, 3, 4]
    rates = [e.value for e in events.Scalars("learning_rate")]
    assert rates == pytest.approx([5e-4, 1e-3 * 0.853553, 5e-4, 1e-3 * 0.146447], rel=1e-4)
    assert len(list((tmp_path / "run" / "tensorboard").iterdir())) == 3  # one per session
    log = (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()
    last = json.loads(log[-1])
    assert events.Scalars("loss/l1")[-1].value == pytest.approx(last["losses"]["l1"])
    assert events.Scalars("held_out/rmse")[-1].value == pytest.approx(last["scores"]["rmse"])
    grids = events.Images("samples")
    assert [(grid.step, grid.width, grid.height) for grid in grids] == [(2, 192, 48), (4, 192, 48)]


def test_without_the_package_one_line_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_rooms(tmp_path / "data")
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    done = _train(tmp_path, "--quiet")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (3, "", 1)
    assert "'.[tensorboard]'" in done.stderr
    assert not (tmp_path / "run").exists()
