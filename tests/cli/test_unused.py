"""Options that nothing written would use, or that contradict each other, are refused at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from helpers.tiny import write_model, write_picture
from helpers.videos import flat_frames, write_video

from depthcli.cli.parse import writer_options
from depthcli.cli.shell import load_command
from depthcli.core.options import Colormap, Near
from depthcli.errors import UsageError

if TYPE_CHECKING:
    from pathlib import Path

    from helpers.command_line import Cli


def run(*words: str) -> None:
    """A command within this process; what it refuses, it refuses before it starts anything."""
    load_command(words[0]).main(list(words[1:]), standalone_mode=False)


@pytest.mark.parametrize(
    ("words", "option", "meant"),
    [
        (("-o", "x.png", "--colormap", "turbo"), "--colormap", "preview"),
        (("-o", "x.png", "--legend"), "--legend", "preview"),
        (("-o", "x.png", "--vmin", "1"), "--vmin", "preview"),
        (("-o", "x.exr", "--png-scale", "256"), "--png-scale", "png16 or json"),
        (("-o", "x.npy", "--half"), "--half", "exr"),
        (("--exr-channel", "Z"), "--exr-channel", "exr"),
        (("-o", "x.preview.png", "--png-normalize"), "--png-normalize", "png16 or json"),
    ],
)
def test_predict_refuses_what_no_format_uses(
    words: tuple[str, ...], option: str, meant: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_picture(tmp_path / "room.png")
    with pytest.raises(UsageError, match=f"^{option} is for {meant}, and only "):
        run("predict", "room.png", *words)
    assert [path.name for path in tmp_path.iterdir()] == ["room.png"]


def test_options_that_a_format_uses_are_taken(inside: Cli) -> None:
    write_picture(inside.folder / "room.png")
    done = inside("predict", "room.png", "-o", "x.json", "--png-scale", "256")
    assert done.returncode == 0, done.stderr
    options = "--colormap", "turbo", "--png-scale", "256"
    assert inside("predict", "room.png", *options).returncode == 0


def test_batch_and_video_refuse_them_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_picture(tmp_path / "in" / "room.png")
    with pytest.raises(UsageError, match=r"^--legend is for preview, and only png16 "):
        run("batch", "in", "--out", "out", "--legend")
    with pytest.raises(UsageError, match=r"^--lock is for mkv, mp4, webm or mov, and only png16 "):
        run("video", "clip.mp4", "--out", "frames/", "--format", "png16", "--lock", "2")
    with pytest.raises(UsageError, match=r"^--no-audio is for mp4, webm or mov, and only mkv "):
        run("video", "clip.mp4", "--format", "mkv", "--no-audio")
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_a_depth_video_takes_the_range_of_its_values(inside: Cli) -> None:
    relative = {"output__kind": "relative", "output__min_m": None, "output__max_m": None}
    write_model(inside.models / "default", **relative)
    write_video(inside.folder / "clip.avi", flat_frames(range(3)))
    done = inside("video", "clip.avi", "-o", "d.mkv", "--vmin", "1", "--vmax", "2")
    assert done.returncode == 0, done.stderr


def test_a_profile_may_hold_more_than_a_run_uses(inside: Cli) -> None:
    write_picture(inside.folder / "room.png")
    assert inside("profile", "save", "own", "--colormap", "turbo", "--half").returncode == 0
    done = inside("predict", "room.png", "-o", "x.png", "--profile", "own")
    assert done.returncode == 0, done.stderr


def looks(colormap: Colormap | None, near: Near | None) -> tuple[str, str]:
    chosen = writer_options({"colormap": colormap, "near": near})
    return chosen.colormap, chosen.near


def test_white_and_black_mean_gray() -> None:
    assert looks(None, None) == ("inferno", "warm")
    assert looks(None, Near.WARM) == ("inferno", "warm")
    assert looks(None, Near.WHITE) == ("gray", "white")
    assert looks(Colormap.GRAY, Near.BLACK) == ("gray", "black")
    for colormap, near in ((Colormap.INFERNO, Near.BLACK), (Colormap.TURBO, Near.WHITE)):
        with pytest.raises(UsageError, match=f"--near {near} is for --colormap gray"):
            looks(colormap, near)
    with pytest.raises(UsageError, match="gray has no warm end"):
        looks(Colormap.GRAY, Near.WARM)


def test_limits_the_wrong_way_round_are_refused() -> None:
    with pytest.raises(UsageError, match="--vmin 5 is above --vmax 2; swap them"):
        writer_options({"vmin": 5, "vmax": 2})


def test_near_white_is_a_gray_picture(inside: Cli) -> None:
    write_picture(inside.folder / "room.png")
    assert inside("predict", "room.png", "-o", "x.preview.png", "--near", "white").returncode == 0
    pixels = cv2.imread(str(inside.folder / "x.preview.png"))
    assert pixels is not None
    assert (np.ptp(pixels, axis=2) == 0).all()
    assert np.ptp(pixels) > 200
