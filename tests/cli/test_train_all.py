"""``depthcli train --all``: several methods under one budget, as a user runs them."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.command_line import unmeasured
from helpers.rooms import write_rooms
from helpers.runs import ENVIRONMENT, inside

from depthcli.cli.app import main
from depthcli.cli.commands.train import _forwarded_options, _queue_request
from depthcli.cli.loading import plain_command
from depthcli.training.checkpoint import Checkpoint

TINY = """
[generator]
width = 4
blocks = 1

[data]
width = 32
height = 32
holdout_every = 4
holdout_offset = 1

[optim]
epochs_constant = 1
epochs_decay = 0
width_discriminator = 2
"""


def _command(*arguments: str) -> list[str]:
    common = ["--data", "data", "--out", "runs", "--config", "tiny.toml"]
    common += ["--threads", "1", "--accelerator", "cpu"]
    return [sys.executable, "-m", "depthcli", "train", *common, *arguments]


def _train(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return inside(folder, *_command(*arguments)[3:])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A data set and a file of settings."""
    write_rooms(tmp_path / "data")
    (tmp_path / "tiny.toml").write_text(TINY)
    return tmp_path


def _progress(folder: Path, run: str) -> tuple[str, int, int]:
    saved = Checkpoint.load(folder / "runs" / run / "last.ckpt")
    return saved.config.method, saved.config.seed, saved.state.epoch


def test_each_run_gets_the_options_as_they_were_given() -> None:
    command, common = plain_command("train"), ["--methods", "cut", "--data", "d", "--out", "o"]
    sources = ["--pseudo-labels", "more", "--init", "a b.onnx", "--init", "c.ckpt"]
    words = ["--accelerator", "cpu", "--devices", "1"]
    context = command.make_context("train", [*common, *sources, *words])
    assert _forwarded_options(context) == words
    request = _queue_request(context)
    assert (request.extra, request.start) == (Path("more"), (Path("a b.onnx"), Path("c.ckpt")))
    assert "--threads" not in _forwarded_options(command.make_context("train", common))


def test_every_signal_that_ends_a_command_ends_the_run_at_hand() -> None:
    words = ["--all", "--data", "d", "--out", "o"]
    request = _queue_request(plain_command("train").make_context("train", words))
    assert request.signals == (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def test_runs_are_trained_and_then_skipped(folder: Path) -> None:
    arguments = ("--methods", "cyclegan", "--seeds", "0,2")
    done = _train(folder, *arguments, "--set", "seed=5")
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    for seed in (0, 2):
        run = f"cyclegan-seed{seed}"
        assert _progress(folder, run) == ("cyclegan", seed, 1)
        assert f"{run}: finished, epoch 1 of 1" in done.stderr
    assert done.stderr.splitlines()[-1] == "2 of 2 runs finished"
    before = {path: path.stat().st_mtime_ns for path in folder.glob("runs/*/*")}
    (folder / "tiny.toml").write_text("")  # each run knows its own settings
    again = _train(folder, *arguments, "--json")
    assert again.returncode == 0, again.stderr
    assert again.stderr == ""
    lines = [json.loads(line) for line in again.stdout.splitlines()]
    assert [line["state"] for line in lines] == ["finished"] * 2
    assert {path: path.stat().st_mtime_ns for path in folder.glob("runs/*/*")} == before


def test_each_method_is_trained_with_each_seed(folder: Path) -> None:
    done = _train(
        folder, "--methods", "cyclegan, fastcut", "--seeds", "0,2", "--max-minutes", "0", "--json"
    )
    assert (done.returncode, done.stderr) == (0, "")
    runs = [json.loads(line)["run"] for line in done.stdout.splitlines()]
    assert runs == ["cyclegan-seed0", "cyclegan-seed2", "fastcut-seed0", "fastcut-seed2"]


def test_a_failing_method_stops_no_other(folder: Path) -> None:
    broken = folder / "runs" / "cut-seed0"
    broken.mkdir(parents=True)
    (broken / "last.ckpt").write_bytes(b"no checkpoint")
    in_the_way = folder / "runs" / "cyclegan-seed0"
    in_the_way.write_text("a file where a folder should be")
    done = _train(folder, "--methods", "cut,cyclegan,fastcut", "--json", "--quiet")
    assert done.returncode == 1
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    ends = {line["run"]: line["state"] for line in lines if "state" in line}
    assert ends == {"cut-seed0": "failed", "cyclegan-seed0": "failed", "fastcut-seed0": "finished"}
    epochs = [line for line in lines if "state" not in line]
    assert [(line["run"], line["epoch"]) for line in epochs] == [("fastcut-seed0", 1)]
    last = done.stderr.splitlines()[-1]
    assert last.startswith("depthcli: error: 2 of 3 runs failed: cut-seed0 (")
    assert "cyclegan-seed0 (exit code 3" in last
    assert (broken / "last.ckpt").read_bytes() == b"no checkpoint"


def test_a_budget_ends_a_run_that_can_be_continued(folder: Path) -> None:
    """How several runs share a long one is tested with the queue itself."""
    long = ("--set", "optim.epochs_constant=100000", "--set", "validate_every=100000")
    done = _train(folder, "--methods", "fastcut,cut", *long, "--max-minutes", "0.01")
    assert done.returncode == 0, done.stderr
    *_, waiting, last = done.stderr.splitlines()
    assert waiting.startswith("cut-seed0: waiting (no time of")  # the start of the first took it
    assert last.startswith("0 of 2 runs finished, 2 to continue")
    saved = Checkpoint.load(folder / "runs" / "fastcut-seed0" / "last.ckpt")
    assert saved.state.seconds > 0


def test_a_signal_ends_the_run_at_hand_cleanly_and_all_others(folder: Path) -> None:
    arguments = ("--methods", "fastcut,cut", "--set", "optim.epochs_constant=100000", "--json")
    with subprocess.Popen(
        _command(*arguments),
        cwd=folder,
        env=unmeasured(ENVIRONMENT),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["run"] == "fastcut-seed0"
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGTERM, err
    assert json.loads(out.splitlines()[-1])["state"] == "stopped"
    assert not (folder / "runs" / "cut-seed0").exists()
    step = Checkpoint.load(folder / "runs" / "fastcut-seed0" / "last.ckpt").state.step
    assert step >= 5
    time.sleep(0.2)
    log = (folder / "runs" / "fastcut-seed0" / "metrics.jsonl").read_text()
    assert json.loads(log.splitlines()[-1])["step"] <= step


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("cut", "--all"), "not both"),
        (("--all", "--show-config"), "--show-config"),
        (("--methods", "cut,pix2pix"), "no method 'pix2pix'"),
        (("--methods", ","), "take a list"),
        (("--all", "--seeds", "one"), "not 'one'"),
        (("--all", "--set", "loss.similarity=1"), "cyclegan has no loss.similarity"),
        (("cut", "--seeds", "0"), "--seeds goes with"),
        ((), "METHOD"),
    ],
)
def test_wrong_use_is_one_line_before_anything_is_trained(
    folder: Path,
    arguments: tuple[str, ...],
    reason: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(folder)
    assert main(_command(*arguments)[3:]) == 2
    errors = capsys.readouterr().err
    assert reason in errors
    assert errors.count("\n") == 1
    assert not (folder / "runs").exists()


def test_all_is_every_method_and_a_spent_budget_trains_none(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    assert main(_command("--all", "--max-minutes", "0")[3:]) == 0
    out, errors = capsys.readouterr()
    *left, last = errors.splitlines()
    assert (out, len(left)) == ("", 7)
    assert all("waiting (no time of --max-minutes was left for it" in line for line in left)
    assert last == "0 of 7 runs finished, 7 to continue: run the same command again"


def test_missing_data_are_said_once(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    assert main(_command("--all", "--data", "nowhere")[3:]) == 2
    errors = capsys.readouterr().err
    assert errors.count("\n") == 1
    assert "nowhere" in errors
