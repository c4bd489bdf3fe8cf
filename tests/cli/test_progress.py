"""Long commands: a bar with rate and time to go on a terminal, plain lines elsewhere."""

import re

import numpy as np
import pytest
from helpers.command_line import Cli
from helpers.folders import tree
from helpers.videos import write_mp4

from depthcli.cli.screen import progress


def test_a_batch_has_a_bar_on_a_terminal(cli: Cli) -> None:
    tree(cli, "a.png", "b.png", "c.png")
    code, shown = cli.on_a_terminal("batch", "in", "--out", "out")
    assert code == 0
    assert "3/3" in shown
    assert re.search(r"\d inputs/s +0:00 to go", shown)


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
