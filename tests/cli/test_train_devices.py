"""``depthcli train --devices 2``: two processes on a CPU, which talk by gloo."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from helpers.rooms import write_rooms
from helpers.runs import ENVIRONMENT, inside, same, saved

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

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


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set and a file of settings; each test makes runs of its own names."""
    folder = tmp_path_factory.mktemp("devices")
    write_rooms(folder / "data")
    (folder / "small.toml").write_text(SMALL)
    return folder


def _words(out: str, devices: int, *settings: str) -> list[str]:
    words = ["train", "proposed", "--data", "data", "--quiet", "--config", "small.toml"]
    words += ["--accelerator", "cpu", "--threads", "1", "--devices", str(devices), "--out", out]
    return words + [word for setting in settings for word in ("--set", setting)]


def _start(
    folder: Path,
    out: str,
    *settings: str,
    more: tuple[str, ...] = (),
    starter: Sequence[str] = (sys.executable,),
) -> subprocess.Popen[str]:
    """Start a run on two devices."""
    return subprocess.Popen(
        [*starter, "-m", "depthcli", *_words(out, 2, *settings), *more],
        cwd=folder,
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _end(process: subprocess.Popen[str]) -> tuple[int, str]:
    out, errors = process.communicate(timeout=120)
    return process.returncode, out + errors


@pytest.fixture(scope="module")
def whole(folder: Path) -> Path:
    """An unbroken run on two devices."""
    assert _end(_start(folder, "whole")) == (0, "")
    return folder / "whole"


def _losses(folder: Path) -> list[dict[str, float]]:
    lines = (folder / "metrics.jsonl").read_text().splitlines()
    return [json.loads(line)["losses"] for line in lines]


def test_two_processes_learn_what_one_does(folder: Path) -> None:
    both = _start(folder, "on2", *NOTHING_BY_CHANCE)
    one = inside(folder, *_words("on1", 1, *NOTHING_BY_CHANCE))
    assert (one.returncode, one.stdout, one.stderr) == (0, "", "")
    assert _end(both) == (0, "")
    alone, together = _losses(folder / "on1"), _losses(folder / "on2")
    assert len(alone) == len(together) == 3
    for apart, shared in zip(alone, together, strict=True):
        assert shared == pytest.approx(apart, rel=1e-3)
    first, last = alone[0], alone[-1]
    assert last["l1"] < 0.95 * first["l1"]  # far more than the two runs differ


def test_torchrun_starts_the_same_run(folder: Path, whole: Path) -> None:
    """Its processes are those of ``--devices 2``, to the last bit."""
    torchrun = [sys.executable, "-m", "torch.distributed.run"]
    torchrun += ["--nproc-per-node", "2", "--standalone"]
    code, text = _end(_start(folder, "other", starter=torchrun))
    assert code == 0, text
    a, b = saved(whole), saved(folder / "other")
    for name in ("method", "optimizers", "extra", "rng", "others"):
        assert same(a[name], b[name]), name


def test_stopped_run_on_two_processes_is_continued_exactly(folder: Path, whole: Path) -> None:
    assert _end(_start(folder, "parts", more=("--max-minutes", "0"))) == (0, "")
    assert saved(folder / "parts")["state"]["step"] == 1
    assert _end(_start(folder, "parts")) == (0, "")
    a, b = saved(whole), saved(folder / "parts")
    for name in ("method", "optimizers", "extra", "rng", "others"):
        assert same(a[name], b[name]), name
    assert len(a["others"]) == 1
    assert not same(a["others"][0]["rng"], a["rng"])  # each process has a chance of its own
    assert not same(a["others"][0]["extra"], a["extra"])  # and pictures of its own
    assert _losses(whole) == _losses(folder / "parts")
    done = inside(folder, *_words("parts", 1))
    assert done.returncode == 3
