"""Long commands: a bar with rate and time to go on a terminal, plain lines elsewhere."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
import pytest
from folders import tree
from tiny import write_model
from videos import write_mp4

from depthcli.cli import video_progress
from depthcli.cli.screen import console
from depthcli.cli.screen import progress as batch_progress
from depthcli.cli.screen.progress import Tally

if TYPE_CHECKING:
    from command_line import Cli


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
    with console.bar():
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


def test_elsewhere_a_batch_says_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(batch_progress, "_LINE_EVERY_S", 0)
    tally = Tally(4)
    with batch_progress.progress_for(tally, silent=False) as update:
        tally.done = 1
        update()
    assert re.fullmatch(r"1/4  \d+\.\d inputs/s  \d+:\d\d to go\n", capsys.readouterr().err)


def test_elsewhere_a_video_says_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(video_progress, "_LINE_EVERY_S", 0)
    with video_progress.progress_for("a.mp4", silent=False) as update:
        update(2, 4)
    said = capsys.readouterr().err
    assert re.fullmatch(r"a\.mp4: frame 2/4  \d+\.\d frames/s  \d+ s to go\n", said)
