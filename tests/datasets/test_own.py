"""What ``--data`` of ``depthcli train`` may be."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from depthcli.datasets.own import open_training_data
from depthcli.datasets.paired_folder import PairedFolder
from depthcli.datasets.unpaired_folder import UnpairedFolder
from depthcli.errors import DatasetError

if TYPE_CHECKING:
    from pathlib import Path


def _fill(folder: Path, images: list[str], depths: list[str]) -> Path:
    for kind, names in (("rgb", images), ("depth", depths)):
        for number, name in enumerate(names):
            file = folder / kind / f"{name}.png"
            file.parent.mkdir(parents=True, exist_ok=True)
            picture = np.full((6, 8, 3), number, np.uint8)
            depth = np.full((4, 4) if name[0] == "z" else (6, 8), 1000 + number, np.uint16)
            assert cv2.imwrite(str(file), picture if kind == "rgb" else depth)
    return folder


@pytest.mark.parametrize("paired", [True, False])
def test_same_names_are_pairs(tmp_path: Path, *, paired: bool) -> None:
    names = ["hall/1", "hall/2", "lab/1"]
    dataset = open_training_data(_fill(tmp_path, names, names), paired=paired)
    assert isinstance(dataset, PairedFolder)
    assert dataset.scenes == ("hall", "hall", "lab")


def test_other_names_are_two_lists_and_the_shorter_begins_again(tmp_path: Path) -> None:
    folder = _fill(tmp_path, ["a", "b", "c", "d", "e"], ["z1", "z2"])
    dataset = open_training_data(folder, paired=False)
    assert isinstance(dataset, UnpairedFolder)
    assert len(dataset) == len(dataset.ids) == len(set(dataset.ids)) == 5
    assert [int(dataset.image(i)[0, 0, 0]) for i in range(5)] == [0, 1, 2, 3, 4]
    assert [round(float(dataset.depth_m(i)[0, 0]), 3) for i in range(5)] == [1, 1.001] * 2 + [1]
    assert set(dataset.scenes) == set(dataset.official_split) == {""}


def test_more_depth_than_pictures(tmp_path: Path) -> None:
    dataset = open_training_data(_fill(tmp_path, ["a"], ["z1", "z2", "z3"]), paired=False)
    assert dataset.ids == ("a.png z1.png", "a.png z2.png", "a.png z3.png")
    assert int(dataset.image(2)[0, 0, 0]) == 0
    assert round(float(dataset.depth_m(2)[0, 0]), 3) == 1.002


def test_other_names_are_no_pairs(tmp_path: Path) -> None:
    folder = _fill(tmp_path, ["a", "b"], ["a", "c"])
    with pytest.raises(DatasetError, match="without a partner"):
        open_training_data(folder, paired=True)


def test_an_index_makes_it_nyu(tmp_path: Path) -> None:
    folder = _fill(tmp_path, ["0000"], ["0000"])
    (folder / "index.csv").write_text("id,scene,official_split\n0000,attic,train\n")
    assert list(open_training_data(folder, paired=True).scenes) == ["attic"]


@pytest.mark.parametrize("paired", [True, False])
def test_what_is_not_there_is_said(tmp_path: Path, *, paired: bool) -> None:
    with pytest.raises(DatasetError, match="does not exist"):
        open_training_data(tmp_path / "none", paired=paired)
    with pytest.raises(DatasetError, match="is missing"):
        open_training_data(tmp_path, paired=paired)
