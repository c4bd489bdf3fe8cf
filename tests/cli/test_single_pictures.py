"""A single picture given to ``depthcli video``: the message says what to give instead."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import OpenEXR
import pytest

from depthcli.video.numbering import number_in, pattern_of

if TYPE_CHECKING:
    from helpers.command_line import Cli


@pytest.mark.parametrize(
    ("stem", "pattern"),
    [
        ("p.0001", "p.####"),
        ("p.1001", "p.####"),
        ("p.01", "p.##"),
        ("f10", "f%d"),
        ("f0", "f%d"),
        ("v2_f7_left", "v2_f%d_left"),
        ("000012", "######"),
        ("photo", None),
        ("a%d.0001", None),
        ("t1234567890123", None),
    ],
)
def test_the_pattern_of_a_name(stem: str, pattern: str | None) -> None:
    assert pattern_of(stem) == pattern
    if pattern is not None:
        assert number_in(pattern, stem) is not None


def test_a_single_plate_is_for_predict_and_numbered_ones_for_video(inside: Cli) -> None:
    (inside.folder / "e").mkdir()
    ramp = np.linspace(0, 1, 64, dtype=np.float32)[None].repeat(48, 0)
    file = OpenEXR.File({"type": OpenEXR.scanlineimage}, dict.fromkeys("RGB", ramp))
    file.write(str(inside.folder / "e" / "p.0001.exr"))
    done = inside("predict", "e/p.0001.exr")
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.startswith(
        b"e/p.0001.exr -> e/p.0001.depth.png, e/p.0001.preview.png  min 2.140"
    )
    for options, code in ((), 1), (("--fps", "24"), 2):
        done = inside("video", "e/p.0001.exr", *options)
        assert done.returncode == code
        (line,) = done.stderr.decode().splitlines()
        said = "e/p.0001.exr is a single picture: use 'depthcli predict', or give its sequence, "
        assert line.endswith(f"{said}such as 'e/p.####.exr'")
    assert inside("video", "e/p.####.exr", "--fps", "24", "--out", "d.mkv").returncode == 0


@pytest.mark.parametrize(
    ("name", "instead"),
    [
        ("f10.png", "use 'depthcli predict', or give its sequence, such as 'f%d.png'"),
        ("a.jpg", "use 'depthcli predict', or give its sequence, as a folder of its own"),
    ],
)
def test_a_single_picture_is_for_predict(name: str, instead: str, inside: Cli) -> None:
    cv2.imwrite(str(inside.folder / name), np.full((16, 16, 3), 99, np.uint8))
    done = inside("video", name)
    assert done.returncode == 1
    assert done.stderr.decode().endswith(f"{name} is a single picture: {instead}\n")


def test_a_gif_is_a_video(inside: Cli) -> None:
    (inside.folder / "a.gif").write_bytes(b"GIF89a")
    assert b"holds no video" in inside("video", "a.gif").stderr
    assert b"is a video" in inside("video", "a.gif", "--fps", "24").stderr
