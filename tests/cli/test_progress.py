"""Long commands: a bar with rate and time to go on a terminal, plain lines elsewhere."""

from __future__ import annotations

import re
import sys
from contextlib import ExitStack
from typing import TYPE_CHECKING

import numpy as np
import pytest
from helpers.folders import tree
from helpers.tiny import write_model
from helpers.videos import write_mp4

from depthcli.cli.screen import console, progress, training
from depthcli.cli.screen.training import JsonCallback, TextCallback
from depthcli.training.callbacks import TrainStart
from depthcli.training.checkpoint import TrainState
from depthcli.training.devices import Threads

if TYPE_CHECKING:
    from helpers.command_line import Cli


def test_a_batch_has_a_bar_on_a_terminal(cli: Cli) -> None:
    tree(cli, "a.png", "b.png", "c.png")
    code, shown = cli.on_a_terminal("batch", "in", "--out", "out")
    assert code == 0
    assert "3/3" in shown
    assert re.search(r"\d inputs/s +0:00 to go", shown)


def test_lines_beside_a_bar_are_whole_and_in_any_language(cli: Cli) -> None:
    write_model(
        cli.models / "default", output__kind="inverse", output__min_m=None, output__max_m=None
    )
    name = "Größe [b]einer 部屋 " + "x" * 60
    tree(cli, f"{name}.png")
    code, shown = cli.on_a_terminal("batch", "in", "--out", "out", columns=40)
    assert code == 0
    assert f"warning: {name}.png: inverse depth has no unit; png is normalized" in shown


def test_results_go_to_their_file_while_a_bar_is_shown(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # Rich takes standard error for a terminal
    with console.progress_bar():
        console.out("Größe")
    assert capfd.readouterr().out == "Größe\n"


def test_a_video_has_a_bar_on_a_terminal(cli: Cli) -> None:
    write_mp4(cli.folder / "clip.mp4", [np.full((48, 64, 3), 90, np.uint8)] * 5)
    code, shown = cli.on_a_terminal("video", "clip.mp4")
    assert code == 0
    assert "5/5" in shown
    assert re.search(r"\d frames/s", shown)


@pytest.mark.parametrize("words", [("--quiet",), ("--json",)])
def test_no_bar_for_machines(cli: Cli, words: tuple[str, ...]) -> None:
    tree(cli, "a.png")
    code, shown = cli.on_a_terminal("batch", "in", "--out", "out", *words)
    assert code == 0
    assert "to go" not in shown
    assert "1/1" not in shown


def test_elsewhere_a_line_is_said_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "_LINE_EVERY_S", 0)
    with progress.show_progress(silent=False) as drawing:
        drawing.begin("a.mp4", 4, "frames")(2)
    said = capsys.readouterr().err
    assert re.fullmatch(r"a\.mp4: 2/4  \d+\.\d frames/s  \d+:\d\d to go\n", said)


def test_what_took_no_time_says_nothing_of_the_time_to_go(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "_LINE_EVERY_S", 0)
    with progress.show_progress(silent=False) as drawing:
        stage = drawing.begin("", 4, "inputs")
        stage.note = "1 failed"
        stage.skip(3)
    assert capsys.readouterr().err == "3/4  0.0 inputs/s  1 failed\n"


def test_a_stage_of_unknown_length_is_announced_where_that_is_wanted(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with progress.show_progress(silent=False, announce=True) as drawing:
        drawing.begin("predicting", None)(1)
    assert capsys.readouterr().err == "predicting\n"


def test_another_coding_of_initial_weights_is_one_warning(
    capfd: pytest.CaptureFixture[str],
) -> None:
    how = ("output.max_m is 80.0 there, 10.0 here", 'data.colour is "luma" there, "value" here')
    start = TrainStart(Threads(1, 1, timed=False), False, 0, other_coding=how)
    JsonCallback().on_train_start(start)
    assert capfd.readouterr().err == (
        "depthcli: warning: the initial weights are used as they are, but they were trained with "
        f"other settings: {how[0]}; {how[1]}\n"
    )


def test_a_training_run_that_goes_on_has_a_bar_from_where_it_was(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # Rich takes standard error for a terminal
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr(progress, "_BAR_EVERY_S", 0)
    with ExitStack() as stack:
        lines = TextCallback(stack)
        threads = Threads(1, 1, timed=False)
        lines.on_train_start(TrainStart(threads, lacks_scenes=False, seen_held_out=0))
        lines.on_step_end(TrainState(step=400), 1000, {})
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", capfd.readouterr().err)
    assert "training" in shown
    assert " 400/1000 " in shown
    assert re.search(r"\d steps/s +\d+:\d\d to go", shown)


def test_the_rate_of_training_is_that_of_its_steps(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Reading the data, before the first step, does not count."""
    clock = iter([0.0, 100.0, 100.5, 102.0])
    monkeypatch.setattr(training.time, "monotonic", lambda: next(clock))
    with ExitStack() as stack:
        lines = TextCallback(stack)
        lines.on_step_end(TrainState(step=1), 131, {})
        lines.on_epoch_end(TrainState(step=1, epoch=1))
        assert "steps/s" not in capfd.readouterr().err  # the first step is not measured
        for step in range(2, 12):
            lines.on_step_end(TrainState(step=step), 131, {})
        lines.on_epoch_end(TrainState(step=11, epoch=2))
    assert "5.00 steps/s  0 min to go" in capfd.readouterr().err
