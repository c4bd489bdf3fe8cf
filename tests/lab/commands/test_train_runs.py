"""``depthcli train`` of several methods and seeds, and when something goes wrong."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.command_line import finished, unmeasured
from helpers.file_trees import contents
from helpers.runs import ENVIRONMENT, RESNET_TOML, inside, same, saved, write_run

EPOCHS = ("cyclegan", "--set", "optim.epochs_decay=3", "--set", "validate_every=99", "--quiet")
"""Twenty steps in four epochs."""
LONG = ("--set", "optim.epochs_constant=100000", "--set", "validate_every=100000")


def _words(*arguments: str) -> list[str]:
    common = ["--data", "data", "--config", "tiny.toml", "--threads", "1", "--accelerator", "cpu"]
    return ["train", *common, *arguments]


def _train(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return inside(folder, *_words(*arguments))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_run(tmp_path, RESNET_TOML)


def test_runs_are_those_of_single_commands_and_are_resumed(folder: Path) -> None:
    several = ("--methods", "cyclegan,fastcut", "--seeds", "2", "--seeds", "0", "-o", "runs")
    done = _train(folder, *several, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    names = ["cyclegan-seed2", "cyclegan-seed0", "fastcut-seed2", "fastcut-seed0"]
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert [(line["run"], line["epoch"]) for line in lines] == [(name, 1) for name in names]
    assert _train(folder, "fastcut", "--set", "seed=2", "-o", "alone").returncode == 0
    looped, alone = saved(folder / "runs" / "fastcut-seed2"), saved(folder / "alone")
    parts = looped.keys() - {"state"}  # it has the time
    assert all(same(looped[part], alone[part]) for part in parts)
    (folder / "tiny.toml").write_text("")  # each run knows its own settings
    again = _train(folder, *several, "--json")
    assert (again.returncode, again.stdout, again.stderr) == (0, "", "")


def test_grid_has_a_resumable_run_for_each_combination(folder: Path) -> None:
    grid = ("cyclegan", "--grid", "loss.cycle=1,2", "--grid", "loss.identity=0,5", "-o", "runs")
    done = _train(folder, *grid, "--json")
    assert done.returncode == 0, done.stderr
    names = [f"loss.cycle={a}-loss.identity={b}" for a in (1, 2) for b in (0, 5)]
    assert [json.loads(line)["run"] for line in done.stdout.splitlines()] == [
        f"cyclegan-{name}-seed0" for name in names
    ]
    loss = saved(folder / "runs" / "cyclegan-loss.cycle=2-loss.identity=0-seed0")["config"]["loss"]
    assert (loss["cycle"], loss["identity"]) == (2, 0)
    assert _train(folder, *grid, "--json").stdout == ""


def test_failing_run_stops_no_other(folder: Path) -> None:
    broken = folder / "runs" / "cut-seed0"
    broken.mkdir(parents=True)
    (broken / "last.ckpt").write_bytes(b"no checkpoint")
    done = _train(folder, "--methods", "cut,fastcut", "--json", "--quiet", "-o", "runs")
    assert done.returncode == 1
    assert [json.loads(line)["run"] for line in done.stdout.splitlines()] == ["fastcut-seed0"]
    (line,) = done.stderr.splitlines()
    assert "cut-seed0: " in line
    assert (broken / "last.ckpt").read_bytes() == b"no checkpoint"


def test_time_limit_is_shared_by_the_runs(folder: Path) -> None:
    done = _train(folder, "--methods", "fastcut,cut", *LONG, "--max-minutes", "0.05", "-o", "runs")
    assert done.returncode == 0, done.stderr
    for name in ("fastcut-seed0", "cut-seed0"):
        assert 0 < saved(folder / "runs" / name)["state"]["seconds"] < 3


def test_signal_ends_all_runs_with_a_checkpoint(folder: Path) -> None:
    words = _words("--methods", "fastcut,cut", *LONG, "--json", "-o", "runs")
    with subprocess.Popen(
        [sys.executable, "-m", "depthcli", *words],
        cwd=folder,
        env=unmeasured(ENVIRONMENT),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert json.loads(process.stdout.readline())["run"] == "fastcut-seed0"
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGTERM, err
    assert (folder / "runs" / "fastcut-seed0" / "last.ckpt").exists()
    assert not (folder / "runs" / "cut-seed0").exists()


def test_signal_saves_the_step_and_the_run_goes_on_exactly(folder: Path) -> None:
    log = folder / "run" / "metrics.jsonl"
    command = [sys.executable, "-m", "depthcli", *_words(*EPOCHS, "--out", "run")]
    environment = unmeasured(ENVIRONMENT)
    process = subprocess.Popen(
        command, cwd=folder, env=environment, stderr=subprocess.PIPE, text=True
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
    for out in ("run", "unbroken"):
        assert _train(folder, *EPOCHS, "--out", out).returncode == 0
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
    assert _train(folder, *EPOCHS, "--out", "run", "--max-minutes", "0").returncode == 0
    before = contents(folder / "run")
    command = [sys.executable, "-m", "depthcli", *_words(*EPOCHS, "--out", "run")]
    done = finished([sys.executable, "-c", _FULL, *command], folder, env=unmeasured(ENVIRONMENT))
    assert (done.returncode, done.stderr.count("\n")) == (3, 1), done.stderr
    assert "run/last.ckpt" in done.stderr
    after = contents(folder / "run")
    assert after.pop("metrics.jsonl", b"")  # an epoch was logged that is not in the checkpoint
    assert after == before
    assert _train(folder, *EPOCHS, "--out", "run").returncode == 0
    log = (folder / "run" / "metrics.jsonl").read_text().splitlines()
    assert len(log) == 4  # each epoch once
    assert saved(folder / "run")["state"]["step"] == 20
