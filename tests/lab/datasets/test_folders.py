"""Folders of pairs, and splits of them."""

import doctest
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from helpers.in_memory import InMemory
from helpers.made import exif, jpeg_with_exif
from helpers.tiny import write_image
from hypothesis import given, strategies as st

from depthcli.errors import DatasetError
from depthcli.lab.datasets import base as splits
from depthcli.lab.datasets.base import SplitName, held_out_scenes, split_nyu
from depthcli.lab.datasets.folders import open_paired_folder, open_unpaired_folder
from depthcli.lab.evaluation.task import plan_nyu
from depthcli.lab.metrics import depth as metrics


def _write(path: Path, value: int, *, depth: bool, size: tuple[int, int] = (6, 8)) -> None:
    pixels = np.full(size, value, np.uint16) if depth else np.full((*size, 3), value, np.uint8)
    write_image(path, pixels)


def _pair(folder: Path, image: str, value: int, depth: str, millimetres: int) -> None:
    _write(folder / "rgb" / image, value, depth=False)
    _write(folder / "depth" / depth, millimetres, depth=True)


def test_predicted_depth_belongs_to_its_image(tmp_path: Path) -> None:
    _write(tmp_path / "rgb" / "hall" / "a.png", 10, depth=False)
    _write(tmp_path / "depth" / "hall" / "a.depth.png", 2000, depth=True)
    dataset = open_paired_folder(tmp_path)
    assert (dataset.ids, float(dataset.depth_m(0)[0, 0])) == (("hall/a",), 2.0)
    _write(tmp_path / "depth" / "hall" / "a.png", 2000, depth=True)
    with pytest.raises(DatasetError):
        open_paired_folder(tmp_path)


def test_depth_that_cannot_be_millimetres(tmp_path: Path) -> None:
    _pair(tmp_path, "a.jpg", 10, "a.png", 20)
    with pytest.raises(DatasetError):
        open_paired_folder(tmp_path)


def test_hidden_files_and_folders_are_passed_over(tmp_path: Path) -> None:
    _pair(tmp_path, "a.jpg", 10, "a.png", 2000)
    (tmp_path / "rgb" / "._a.jpg").write_bytes(b"resource fork")
    (tmp_path / "rgb" / "b.png").mkdir()
    (tmp_path / "depth" / "notes.txt").write_text("hello")
    assert open_paired_folder(tmp_path).ids == ("a",)


def test_depth_of_another_size_is_compared_in_the_view_of_its_image(tmp_path: Path) -> None:
    """As in ScanNet, where the two cameras have sizes of their own."""
    _write(tmp_path / "rgb" / "a.png", 10, depth=False, size=(12, 16))
    halves = np.repeat(np.uint16([[1000, 3000]]), 4, axis=1) * np.ones((6, 1), np.uint16)
    write_image(tmp_path / "depth" / "a.png", halves)
    depth_m = open_paired_folder(tmp_path).depth_m(0)
    np.testing.assert_array_equal(depth_m, np.repeat([[1.0, 3.0]], 8, axis=1) * np.ones((12, 1)))
    _write(tmp_path / "rgb" / "a.png", 10, depth=False, size=(12, 12))
    with pytest.raises(DatasetError):
        open_paired_folder(tmp_path)


def test_image_that_is_turned_upright_takes_upright_depth(tmp_path: Path) -> None:
    image = write_image(tmp_path / "rgb" / "a.jpg", np.zeros((12, 16, 3), np.uint8))
    image.write_bytes(jpeg_with_exif(image.read_bytes(), exif(6)))
    _write(tmp_path / "depth" / "a.png", 2000, depth=True, size=(16, 12))
    dataset = open_paired_folder(tmp_path)
    assert dataset.image(0).shape[:2] == dataset.depth_m(0).shape == (16, 12)


@pytest.mark.parametrize("depth", [None, np.uint16(3), np.uint8(9)])  # none, in metres, in 8 bits
def test_unpaired_folder_without_depth_in_millimetres(
    depth: np.generic | None, tmp_path: Path
) -> None:
    _write(tmp_path / "rgb" / "a.jpg", 10, depth=False)
    (tmp_path / "depth").mkdir()
    if depth is not None:
        write_image(tmp_path / "depth" / "b.png", np.full((4, 4), depth))
    with pytest.raises(DatasetError):
        open_unpaired_folder(tmp_path)


@dataclass(frozen=True)
class Listed(InMemory):
    """Names only."""

    ids: tuple[str, ...]
    scenes: tuple[str, ...]
    official_split: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.ids)


def _listed(labels: range) -> Listed:
    return Listed(
        ids=tuple(f"{i:04d}" for i in labels),
        scenes=tuple(f"room_{i // 4:04d}" for i in labels),
        official_split=tuple("train" if i % 2 else "test" for i in labels),
    )


COMPLETE = _listed(range(1449))


def test_paper_split() -> None:
    split = split_nyu(COMPLETE, SplitName.PAPER)
    assert split.train == tuple(range(1000))
    assert split.test == tuple(range(1000, 1449))
    assert (split.train_count, split.test_count) == (1000, 449)


@pytest.mark.parametrize(
    ("labels", "name"),
    [
        (range(1000), SplitName.PAPER),
        (range(1, 2), SplitName.OFFICIAL),
        (range(8), SplitName.VAL),
    ],
)
def test_split_without_a_test_pair_is_refused(labels: range, name: SplitName) -> None:
    with pytest.raises(DatasetError):
        plan_nyu(_listed(labels), name)


def test_paper_split_of_the_test_part_alone() -> None:
    split = split_nyu(_listed(range(1000, 1449)), SplitName.PAPER)
    assert split.train == ()
    assert split.test == tuple(range(449))


def test_a_part_of_the_pairs_is_not_the_complete_validation_split() -> None:
    whole, part = (split_nyu(_listed(range(n)), SplitName.VAL) for n in (1000, 200))
    assert (whole.train_count, whole.test_count) == (len(whole.train), len(whole.test))
    assert (part.train_count, part.test_count) == (866, 134)
    assert len(part.test) < 40


def test_official_split_follows_the_index() -> None:
    split = split_nyu(_listed(range(1000)), SplitName.OFFICIAL)
    assert split.train == tuple(range(1, 1000, 2))
    assert split.test == tuple(range(0, 1000, 2))
    assert (split.train_count, split.test_count) == (795, 654)


def test_official_split_is_not_guessed() -> None:
    unknown = Listed(COMPLETE.ids, COMPLETE.scenes, ("",) * 1449)
    with pytest.raises(DatasetError):
        split_nyu(unknown, SplitName.OFFICIAL)


def test_val_split_holds_out_whole_scenes_of_the_first_thousand() -> None:
    split = split_nyu(COMPLETE, SplitName.VAL)
    assert set(split.train) | set(split.test) == set(range(1000))
    train_scenes = {COMPLETE.scenes[i] for i in split.train}
    test_scenes = {COMPLETE.scenes[i] for i in split.test}
    assert not train_scenes & test_scenes
    assert test_scenes == held_out_scenes(COMPLETE.scenes[:1000])
    assert 0.1 < len(split.test) / 1000 < 0.2


def test_val_split_is_the_same_with_and_without_the_test_part() -> None:
    assert split_nyu(_listed(range(1000)), SplitName.VAL) == split_nyu(COMPLETE, SplitName.VAL)


@pytest.mark.parametrize("bad", ["kitchen", "1449", "-1", ""])
def test_id_that_is_no_label(bad: str) -> None:
    with pytest.raises(DatasetError):
        split_nyu(Listed((bad,), ("a",), ("test",)), SplitName.PAPER)


@given(
    scenes=st.lists(st.sampled_from(["", *"abcdefgh"]), max_size=40),
    every=st.integers(1, 9),
    offset=st.integers(0, 9),
)
def test_held_out_scenes_do_not_depend_on_order_or_repetition(
    scenes: list[str], every: int, offset: int
) -> None:
    names = enumerate(sorted(set(scenes)))
    expected = {s for n, s in names if s and n in range(offset, 41, every)}
    assert held_out_scenes(scenes, every, offset) == expected
    assert held_out_scenes([*reversed(scenes), *scenes], every, offset) == expected


@pytest.mark.parametrize("module", [splits, metrics])
def test_examples_in_the_docstrings(module: ModuleType) -> None:
    result = doctest.testmod(module)
    assert result.attempted > 0
    assert result.failed == 0


@given(st.sets(st.integers(0, 1448)))
def test_compact_ids_are_parsed_back(numbers: set[int]) -> None:
    ids = [f"{number:04d}" for number in numbers]
    assert splits.parse(splits.compact(ids)) == numbers
