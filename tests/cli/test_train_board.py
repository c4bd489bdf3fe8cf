"""``depthcli train --tensorboard``, read back by TensorBoard itself."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "training"))
from rooms import write_rooms
from runs import ENVIRONMENT, finished

if TYPE_CHECKING:
    import subprocess

ROOT = Path(__file__).parents[2]
SETTINGS = (
    "generator.name=efficient",
    "generator.encoder=[4,4,8,8,8]",
    "generator.decoder=[8,8,4,4]",
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


def _train(folder: Path, *more: str, path: str = "") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "depthcli", "train", "proposed", "--preset", "default"]
    command += ["--data", "data", "--out", "run", "--accelerator", "cpu", "--threads", "1"]
    command += ["--quiet", "--tensorboard", *more]
    for setting in SETTINGS:
        command += ["--set", setting]
    env = {**ENVIRONMENT, "PYTHONPATH": f"{path}{os.pathsep}{ROOT}"}
    return finished(command, folder, env=env)


def _events(folder: Path) -> Any:
    from tensorboard.backend.event_processing.event_accumulator import (  # noqa: PLC0415
        EventAccumulator,
    )

    return EventAccumulator(str(folder)).Reload()


def test_tensorboard_has_every_step_once_of_a_run_in_two_sittings(tmp_path: Path) -> None:
    write_rooms(tmp_path / "data")
    for limit in (("--max-minutes", "0"), ()):
        done = _train(tmp_path, *limit)
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    events = _events(tmp_path / "run" / "tensorboard")
    assert set(events.Tags()["scalars"]) > {"loss/l1", "loss/gradient", "held_out/d1"}
    assert [e.step for e in events.Scalars("loss/l1")] == [1, 2, 3, 4]
    rates = [e.value for e in events.Scalars("learning_rate")]
    assert rates == pytest.approx([5e-4, 1e-3 * 0.853553, 5e-4, 1e-3 * 0.146447], rel=1e-4)
    log = (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()
    last = json.loads(log[-1])
    assert events.Scalars("loss/l1")[-1].value == pytest.approx(last["losses"]["l1"])
    assert events.Scalars("held_out/rmse")[-1].value == pytest.approx(last["scores"]["rmse"])
    grids = events.Images("samples")
    assert [(grid.step, grid.width, grid.height) for grid in grids] == [(2, 192, 48), (4, 192, 48)]


def test_without_the_package_one_line_says_what_to_install(tmp_path: Path) -> None:
    write_rooms(tmp_path / "data")
    (tmp_path / "without").mkdir()
    (tmp_path / "without" / "tensorboard.py").write_text("raise ImportError\n")
    done = _train(tmp_path, path=str(tmp_path / "without"))
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (3, "", 1)
    assert "pip install tensorboard" in done.stderr
    assert not (tmp_path / "run").exists()
