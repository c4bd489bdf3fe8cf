"""``depthcli train --devices 2``: two processes on a CPU, which talk by gloo."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "training"))
from rooms import write_rooms
from runs import ENVIRONMENT, same, saved

if TYPE_CHECKING:
    from collections.abc import Sequence

SMALL = """
validate_every = 9

[generator]
width = 8
blocks = 1

[data]
width = 32
height = 32
holdout_every = 4
holdout_offset = 1

[optim]
batch_size = 4
epochs_constant = 2
epochs_decay = 1
pool_size = 1
width_discriminator = 4
"""
"""One step an epoch, so that the log has the losses of every step."""
NOTHING_BY_CHANCE = (
    "optim.pool_size=0",
    "loss.contrast_x=0.0",
    "loss.contrast_y=0.0",
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A data set and a file of settings."""
    write_rooms(tmp_path / "data")
    (tmp_path / "small.toml").write_text(SMALL)
    return tmp_path


def _start(
    folder: Path,
    out: str,
    devices: int,
    *settings: str,
    more: tuple[str, ...] = (),
    starter: Sequence[str] = (sys.executable,),
) -> subprocess.Popen[str]:
    command = [*starter, "-m", "depthcli", "train", "proposed", "--data", "data", "--quiet"]
    command += ["--config", "small.toml", "--accelerator", "cpu", "--threads", "1", "--out", out]
    command += ["--devices", str(devices), *more]
    for setting in settings:
        command += ["--set", setting]
    return subprocess.Popen(
        command,
        cwd=folder,
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _end(process: subprocess.Popen[str]) -> tuple[int, str]:
    out, errors = process.communicate(timeout=120)
    return process.returncode, out + errors


def _losses(folder: Path) -> list[dict[str, float]]:
    lines = (folder / "metrics.jsonl").read_text().splitlines()
    return [json.loads(line)["losses"] for line in lines]


def test_two_processes_learn_what_one_does(folder: Path) -> None:
    runs = [_start(folder, f"on{n}", n, *NOTHING_BY_CHANCE) for n in (1, 2)]
    assert [_end(run) for run in runs] == [(0, ""), (0, "")]
    alone, together = _losses(folder / "on1"), _losses(folder / "on2")
    assert len(alone) == len(together) == 3
    for one, two in zip(alone, together, strict=True):
        assert two == pytest.approx(one, rel=1e-3)
    first, last = alone[0], alone[-1]
    assert last["l1"] < 0.95 * first["l1"]  # far more than the two runs differ


def test_torchrun_starts_the_same_run(folder: Path) -> None:
    """Its processes are those of ``--devices 2``, to the last bit."""
    own = _start(folder, "own", 2)
    torchrun = [
        sys.executable,
        "-m",
        "torch.distributed.run",
        "--nproc-per-node",
        "2",
        "--standalone",
    ]
    process = _start(folder, "other", 2, starter=torchrun)
    assert _end(own) == (0, "")
    code, text = _end(process)
    assert code == 0, text
    a, b = saved(folder / "own"), saved(folder / "other")
    for name in ("method", "optimizers", "extra", "rng", "others"):
        assert same(a[name], b[name]), name


def test_stopped_run_on_two_processes_is_continued_exactly(folder: Path) -> None:
    whole = _start(folder, "whole", 2)
    assert _end(_start(folder, "parts", 2, more=("--max-minutes", "0"))) == (0, "")
    assert saved(folder / "parts")["progress"]["step"] == 1
    assert _end(_start(folder, "parts", 2)) == (0, "")
    assert _end(whole) == (0, "")
    a, b = saved(folder / "whole"), saved(folder / "parts")
    for name in ("method", "optimizers", "extra", "rng", "others"):
        assert same(a[name], b[name]), name
    assert len(a["others"]) == 1
    assert not same(a["others"][0]["rng"], a["rng"])  # each process has a chance of its own
    assert not same(a["others"][0]["extra"], a["extra"])  # and pictures of its own
    assert _losses(folder / "whole") == _losses(folder / "parts")
    code, text = _end(_start(folder, "whole", 1))
    assert code == 3
    assert "belongs to a run on 2 devices: give --devices 2" in text


def test_errors_of_two_processes_are_one_line(folder: Path) -> None:
    (folder / "taken").touch()
    cases = {
        ("odd", "optim.batch_size=3"): (2, "set it to a multiple of 2"),
        ("wild", "optim.learning_rate=1e30"): (3, "loss term '"),
        ("taken", "seed=1"): (3, "cannot write to taken"),
    }
    runs = {case: _start(folder, case[0], 2, case[1]) for case in cases}
    for case, (code, reason) in cases.items():
        found, text = _end(runs[case])
        assert (found, text.count("\n")) == (code, 1), text
        assert reason in text
