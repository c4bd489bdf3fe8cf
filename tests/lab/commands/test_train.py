"""``depthcli train`` as a user runs it, on a tiny folder."""

import json
import subprocess
import sys
import tomllib
from contextlib import ExitStack
from pathlib import Path

import pytest
from helpers.command_line import finished
from helpers.runs import ENVIRONMENT, inside, write_run

from depthcli.cli.app import main
from depthcli.cli.options import ScreenOptions
from depthcli.core.parallel import usable_cores
from depthcli.lab.commands.screen import EpochCallback
from depthcli.lab.training.checkpoint import Checkpoint
from depthcli.lab.training.provenance import TrainState


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_run(tmp_path)


COMMON = ("proposed", "--data", "data", "--out", "run", "--preset", "bundled")
COMMON += ("--config", "tiny.toml", "--threads", "1", "--accelerator", "cpu")


def _train(folder: Path, *more: str) -> subprocess.CompletedProcess[str]:
    return inside(folder, "train", *COMMON, *more)


def test_trains_stops_continues_and_reports(folder: Path) -> None:
    settings = ("--set", "validate_every=1")
    command = [sys.executable, "-m", "depthcli", "train", *COMMON]
    stopped = finished([*command, *settings, "--max-minutes", "0"], folder, env=ENVIRONMENT)
    assert stopped.returncode == 0, stopped.stderr
    assert stopped.stdout == ""
    done = _train(folder, *settings, "--json")
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert [(line["epoch"], line["step"]) for line in lines] == [(1, 2), (2, 4)]
    logged = (folder / "run" / "metrics.jsonl").read_text().splitlines()
    assert [line["losses"] for line in lines] == [json.loads(line)["losses"] for line in logged]
    assert lines[0]["losses"]["l1"] > 0
    assert 0 < lines[-1]["scores"]["rmse"] < 20
    names = sorted(p.name for p in (folder / "run").iterdir())
    assert names == ["best.ckpt", "last.ckpt", "metrics.jsonl", "samples"]
    last = (folder / "run" / "last.ckpt").read_bytes()
    quiet = _train(folder, *settings, "--quiet")
    assert (quiet.returncode, quiet.stdout, quiet.stderr) == (0, "", "")
    assert (folder / "run" / "last.ckpt").read_bytes() == last
    other = _train(folder, *settings, "--set", "seed=1")
    assert other.returncode == 3
    assert "seed" in other.stderr
    assert other.stderr.count("\n") == 1


def test_a_run_goes_on_with_its_own_settings_and_threads(folder: Path) -> None:
    """Nothing has to be said again, and what is said again has to be the same."""
    assert _train(folder, "--set", "seed=3", "--threads", "2", "--max-minutes", "0").returncode == 0
    begun = Checkpoint.load(folder / "run" / "last.ckpt")
    common = ("--data", "data", "--out", "run", "--accelerator", "cpu", "--quiet")
    again = ("--preset", "bundled", "--config", "tiny.toml", "--set", "seed=3")
    for options in ((), again):
        done = inside(folder, "train", "proposed", *common, *options, "--max-minutes", "0")
        assert (done.returncode, done.stderr) == (0, "")
    saved = Checkpoint.load(folder / "run" / "last.ckpt")
    assert saved.config == begun.config
    assert (saved.state.step, saved.config.seed) == (3, 3)
    if usable_cores() > 1:
        assert begun.state.threads == saved.state.threads == 2
    other = inside(folder, "train", "cut", *common, "--set", "optim.batch_size=4")
    assert other.returncode == 3
    assert "optim.batch_size" in other.stderr


def test_a_finished_run_goes_on_for_more_epochs(folder: Path) -> None:
    """junyanz/pytorch-CycleGAN-and-pix2pix#1124; toml-bom: the file as Notepad saves it."""
    (folder / "tiny.toml").write_text((folder / "tiny.toml").read_text(), "utf-8-sig")
    for epochs, code in ((1, 0), (2, 0), (1, 3)):
        done = _train(folder, "--set", f"optim.epochs_decay={epochs}", "--quiet")
        assert done.returncode == code, done.stderr
        saved = Checkpoint.load(folder / "run" / "last.ckpt")
        assert (
            saved.config.optim.epochs_decay == saved.state.epoch == max(epochs, saved.state.epoch)
        )
    assert "optim.epochs_decay is 2 there, 1 here" in done.stderr


def test_shown_configuration_is_toml_that_gives_itself_back(folder: Path) -> None:
    result = inside(folder, "train", "proposed", "--preset", "bundled", "--show-config")
    assert result.returncode == 0, result.stderr
    values = tomllib.loads(result.stdout)
    assert values["generator"]["name"] == "efficient"
    assert values["loss"]["weight_penalty"] == 0
    (folder / "shown.toml").write_text(result.stdout)
    again = inside(folder, "train", "proposed", "--config", "shown.toml", "--show-config")
    assert again.stdout == result.stdout


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("pix2pix", "--data", "data"), "no method 'pix2pix'; choose from cyclegan, cut"),
        (("propsed",), "did you mean 'proposed'?"),
        (("proposed", "--preset", "papre"), "did you mean 'paper'?"),
        (("proposed", "--lr", "1"), "give --set optim.learning_rate=X"),
        (("proposed", "--epochs", "1"), "give --set optim.epochs_constant=N"),
        (("propsed", "--data", "data"), "no method 'propsed'; did you mean 'proposed'?"),
        (("proposed",), "--data"),
        (("proposed", "--preset", "huge"), "no preset 'huge'"),
        (("proposed", "--set", "optim.speed=1"), "optim.speed is unknown"),
        (("cut", "--set", "method=proposed", "--data", "data"), "of method proposed, not cut"),
        (("proposed", "--config", "none.toml"), "none.toml"),
        (("proposed", "--config", "/dev/zero"), "/dev/zero"),
        (("proposed", "--data", "data", "--accelerator", "abacus"), "abacus"),
        (("proposed", "--data", "data", "--accelerator", "cuda"), "cuda"),
        (("proposed", "--data", "data", "--max-minutes", "-1"), "--max-minutes"),
        (("proposed", "--data", "nowhere"), "nowhere"),
        (("cut", "--methods", "cut", "--data", "data"), "METHOD"),
        (("--methods", "cut,pix2pix", "--data", "data"), "no method 'pix2pix'"),
        (("--methods", ",", "--data", "data"), "METHOD"),
        (("cut", "--seeds", "one", "--data", "data"), "seed"),
        (("cut", "--grid", "loss.cycles=1,2", "--data", "data"), "cycles"),
        (("nowhere:Method", "--data", "data"), "nowhere"),
        (("--data", "data"), "METHOD"),
        (("--methods", "cut,fastcut", "--data", "nowhere", "-q"), "nowhere"),
    ],
)
def test_wrong_use_is_one_line(
    folder: Path,
    arguments: tuple[str, ...],
    reason: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    assert main(["train", *arguments]) == 2
    out, errors = capsys.readouterr()
    assert out == ""
    assert errors.startswith("depthcli: error: ")
    assert reason in errors
    assert errors.count("\n") == 1
    assert not (folder / "runs").exists()


def test_without_scenes_nothing_is_validated_and_a_warning_says_so(folder: Path) -> None:
    (folder / "data" / "index.csv").unlink()
    done = _train(folder, "--json")
    assert done.returncode == 0
    assert done.stderr.startswith("depthcli: warning: ")
    assert json.loads(done.stdout.splitlines()[-1])["scores"] == {}
    assert _train(folder, "--set", "seed=1", "--out", "other", "--quiet").stderr == ""


def test_the_line_of_an_epoch_has_rate_and_time_to_go(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first step is not measured, so that it alone has no rate."""
    clock_s = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: clock_s[0])
    with ExitStack() as stack:
        text = EpochCallback(stack, ScreenOptions())
        for step in (1, 2):
            text.on_step_end(TrainState(step=step), 4, {"l1": 0.5})
            clock_s[0] += 40
            text.on_epoch_end(TrainState(step=step, epoch=step))
    assert capsys.readouterr().err.splitlines() == [
        "epoch 1  step 1/4  l1 0.5000",
        "the 2 steps to go take about 0:00:40 here",
        "training: 2/4  0.03 steps/s  0:01:20 to go",
        "epoch 2  step 2/4  l1 0.5000  0.01 steps/s  0:02:40 to go",
    ]


def test_a_run_of_months_is_a_warning_that_names_a_shorter_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The paper's size on a CPU, 59 s a step, began without a word."""
    clock_s = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: clock_s[0])
    with ExitStack() as stack:
        text = EpochCallback(stack, ScreenOptions())
        text.on_train_start(())
        clock_s[0] += 59
        text.on_step_end(TrainState(step=1), 173_201, {"l1": 0.5})
    (line,) = capsys.readouterr().err.splitlines()
    assert "the 173200 steps to go take about 118 days, 6:33:20 here" in line
    assert "--preset reduced" in line
