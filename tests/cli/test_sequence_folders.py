"""Which files of a folder ``depthcli video`` takes as an image sequence, and in which order."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from depthcli.video.sequence_files import find_pictures

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from command_line import Cli


def write_pictures(folder: Path, numbers: Iterable[int]) -> None:
    folder.mkdir()
    for number in numbers:
        pixels = np.full((16, 16, 3), number * 20, np.uint8)
        cv2.imwrite(str(folder / f"f{number}.png"), pixels)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ("f1 f10 f2 f4 f9", "1:f1 2:f2 4:f4 9:f9 10:f10"),
        ("f10_left f9_left", "9:f9_left 10:f10_left"),
        ("f1 f10 g2", "0:f1 1:f10 2:g2"),
        ("f1 f10 f2 note", "0:f1 1:f10 2:f2 3:note"),
        ("a3 b5 b20", "0:a3 1:b20 2:b5"),
        ("a3 b5 c20", "3:a3 5:b5 20:c20"),
        ("f02 f10 f2", "0:f02 1:f2 2:f10"),
        ("f1000000000000 f9", "0:f9 1:f1000000000000"),
    ],
)
def test_the_order_and_numbers_of_a_folder(names: str, expected: str, tmp_path: Path) -> None:
    for name in names.split():
        (tmp_path / f"{name}.png").touch()
    found = find_pictures(tmp_path)
    assert " ".join(f"{file.number}:{file.path.stem}" for file in found) == expected


def test_unpadded_numbers_of_a_folder_are_those_of_its_pattern(inside: Cli) -> None:
    write_pictures(inside.folder / "f", (1, 2, 4, 9, 10))
    options = ("--fps", "24", "--start", "4f", "--format", "npy", "--json", "--out")
    folder, pattern = (
        json.loads(inside("video", source, *options, out).stdout)
        for source, out in (("f/", "a/"), ("f/f%d.png", "b/"))
    )
    assert (folder["first_frame"], folder["frames"]) == (4, 3)
    assert "missing numbers" in folder["warnings"][0]
    assert folder["warnings"] == pattern["warnings"]
    written, expected = (sorted((inside.folder / out).iterdir()) for out in "ab")
    assert [path.read_bytes() for path in written] == [path.read_bytes() for path in expected]


def test_outputs_in_a_folder_of_pictures_are_ignored_with_any_name(inside: Cli) -> None:
    write_pictures(inside.folder / "f", (1, 2, 10))
    assert inside("video", "f/f%d.png", "--out", "f/d%d.png").returncode == 0
    assert inside("video", "f/f%d.png", "--out", "f/z.%04d.exr").returncode == 0
    assert len(list((inside.folder / "f").iterdir())) == 9
    found = find_pictures(inside.folder / "f")
    assert [(file.number, file.path.name) for file in found] == [
        (1, "f1.png"),
        (2, "f2.png"),
        (10, "f10.png"),
    ]
    assert json.loads(inside("video", "f/", "--out", "d.mkv", "--json").stdout)["frames"] == 3


@pytest.mark.parametrize("source", ["d/", "d/d.%04d.exr"])
def test_a_sequence_of_outputs_is_refused(source: str, inside: Cli) -> None:
    write_pictures(inside.folder / "f", (1, 2))
    assert inside("video", "f/", "--out", "d/d.%04d.exr").returncode == 0
    done = inside("video", source, "--out", "again.mkv")
    assert done.returncode == 1
    (line,) = done.stderr.decode().splitlines()
    assert "d/d.0001.exr was written by depthcli" in line
    assert "'depthcli convert'" in line
