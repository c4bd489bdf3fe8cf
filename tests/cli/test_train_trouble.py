"""``depthcli train`` when something goes wrong: one line, and nothing that was there is lost."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.command_line import unmeasured
from helpers.rooms import write_rooms
from helpers.runs import ENVIRONMENT, finished, inside, same, saved

SMALL = """
validate_every = 999

[generator]
width = 8
blocks = 1

[data]
width = 32
height = 32
holdout_every = 4
holdout_offset = 1

[optim]
epochs_constant = 2
epochs_decay = 2
width_discriminator = 4
pool_size = 2
"""
"""Twenty steps in four epochs."""


def _command(out: str = "run") -> list[str]:
    command = [sys.executable, "-m", "depthcli", "train", "proposed", "--data", "data"]
    command += ["--out", out, "--config", "small.toml", "--accelerator", "cpu", "--threads", "1"]
    return [*command, "--quiet"]


def _run(folder: Path, out: str = "run") -> subprocess.CompletedProcess[str]:
    return inside(folder, *_command(out)[3:])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A data set and a file of settings."""
    write_rooms(tmp_path / "data")
    (tmp_path / "small.toml").write_text(SMALL)
    return tmp_path


def test_signal_saves_the_step_and_the_run_goes_on_exactly(folder: Path) -> None:
    log = folder / "run" / "metrics.jsonl"
    environment = unmeasured(ENVIRONMENT)
    process = subprocess.Popen(
        _command(), cwd=folder, env=environment, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 60
    while not log.exists() and time.monotonic() < deadline:
        time.sleep(0.002)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (128 + signal.SIGINT, "")
    assert sorted(p.name for p in (folder / "run").iterdir()) == ["last.ckpt", "metrics.jsonl"]
    stopped = saved(folder / "run")["state"]["step"]
    assert 5 <= stopped < 20
    assert [_run(folder, out).returncode for out in ("run", "unbroken")] == [0, 0]
    whole, unbroken = saved(folder / "run"), saved(folder / "unbroken")
    for name in ("method", "optimizers", "extra", "rng"):
        assert same(whole[name], unbroken[name]), name


_FULL = """
import os, resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))
os.execv(sys.argv[1], sys.argv[1:])
"""
"""No file grows beyond a fraction of the checkpoint: the disk is full."""


def test_full_disk_is_one_line_and_the_checkpoint_stays(folder: Path) -> None:
    assert inside(folder, *_command()[3:], "--max-minutes", "0").returncode == 0
    before = _snapshot(folder / "run")
    command = [sys.executable, "-c", _FULL, *_command()]
    done = finished(command, folder, env=unmeasured(ENVIRONMENT))
    assert (done.returncode, done.stderr.count("\n")) == (3, 1), done.stderr
    assert "run/last.ckpt" in done.stderr
    after = _snapshot(folder / "run")
    assert after.pop("metrics.jsonl", b"")  # an epoch was logged that is not in the checkpoint
    assert after == before
    assert _run(folder).returncode == 0
    log = (folder / "run" / "metrics.jsonl").read_text().splitlines()
    assert len(log) == 4  # each epoch once
    assert saved(folder / "run")["state"]["step"] == 20


def _snapshot(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}
