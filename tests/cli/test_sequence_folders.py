"""Which files of a folder ``depthcli video`` takes as an image sequence, and in which order."""

import json
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.command_line import Cli

from depthcli.errors import UsageError
from depthcli.video.numbering import find_images


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
        ("a3 b5 c20", "0:a3 1:b5 2:c20"),
        ("a b c2", "0:a 1:b 2:c2"),
        ("1.033333 1.066667 2.000000 2.033333", "0:1.033333 1:1.066667 2:2.000000 3:2.033333"),
        ("12-00-01 12-00-31 12-01-01", "0:12-00-01 1:12-00-31 2:12-01-01"),
        (
            "p.1001.v003 p.1002.v003 p.1004.v003",
            "1001:p.1001.v003 1002:p.1002.v003 1004:p.1004.v003",
        ),
        ("p10.v2 p9.v2 p9999.v2", "9:p9.v2 10:p10.v2 9999:p9999.v2"),
        ("p.1001.v003 p.1002.v004", "0:p.1001.v003 1:p.1002.v004"),
        ("p.1.v003 p.01.v003", "0:p.01.v003 1:p.1.v003"),
    ],
)
def test_the_order_and_numbers_of_a_folder(names: str, expected: str, tmp_path: Path) -> None:
    for name in names.split():
        (tmp_path / f"{name}.png").touch()
    found = find_images(tmp_path)
    assert " ".join(f"{file.number}:{file.path.stem}" for file in found) == expected


@pytest.mark.parametrize(
    ("names", "patterns"),
    [
        ("L.0998.png L.0999.png R.0998.png R.0999.png", "L.####.png R.####.png"),
        ("L.1.png L.3.png R.1.png R.3.png", "L.%d.png R.%d.png"),
        ("p.1001.png p.1002.png p.1001.jpg p.1002.jpg", "p.####.jpg p.####.png"),
        ("p.1001.png p.1005.png sheet.png", "p.####.png"),
        ("v1.1001.png v1.1002.png v2.1001.png v2.1002.png", "v1.####.png v2.####.png"),
        ("p.-1.png p.-2.png p.0.png p.1.png", "p.-%d.png p.%d.png"),
        ("f02.png f10.png f2.png", "f%d.png"),
        ("f9.png f10.png f11_left.png", "f%d.png"),
    ],
)
def test_a_folder_with_two_sequences_is_refused(names: str, patterns: str, tmp_path: Path) -> None:
    for name in names.split():
        (tmp_path / name).touch()
    with pytest.raises(UsageError) as caught:
        find_images(tmp_path)
    said = ", ".join(f"'{tmp_path / pattern}'" for pattern in patterns.split())
    assert str(caught.value).endswith(f"give one as a pattern: {said}")
    for pattern in patterns.split():
        assert find_images(tmp_path / pattern)


def test_outputs_in_a_folder_of_pictures_are_ignored_with_any_name(inside: Cli) -> None:
    write_pictures(inside.folder / "f", (1, 2, 10))
    assert inside("video", "f/f%d.png", "--out", "f/d%d.png").returncode == 0
    assert inside("video", "f/f%d.png", "--out", "f/z.%04d.exr").returncode == 0
    assert len(list((inside.folder / "f").iterdir())) == 9
    found = find_images(inside.folder / "f")
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
    assert "d/d.0001.exr" in line


def test_a_depth_video_is_no_video_to_estimate(inside: Cli) -> None:
    write_pictures(inside.folder / "f", (1, 2))
    assert inside("video", "f/", "--out", "any.mkv", "--fps", "24").returncode == 0
    for words, data in ((("any.mkv",), b""), (("-",), (inside.folder / "any.mkv").read_bytes())):
        done = inside("video", *words, "--out", "again.mkv", stdin=data)
        assert done.returncode == 1
        assert words[0] in done.stderr.decode() or data
    assert not (inside.folder / "again.mkv").exists()
