import doctest
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from depthcli.datasets import base as splits
from depthcli.datasets.base import SplitName, held_out_scenes, split_nyu
from depthcli.errors import DatasetError
from depthcli.evaluation.task import plan_nyu


@dataclass(frozen=True)
class Listed:
    """Names only."""

    ids: tuple[str, ...]
    scenes: tuple[str, ...]
    official_split: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.ids)

    def image(self, i: int) -> np.ndarray:
        raise NotImplementedError

    def depth_m(self, i: int) -> np.ndarray:
        raise NotImplementedError


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


def test_paper_split_of_the_first_thousand_has_nothing_to_test() -> None:
    assert split_nyu(_listed(range(1000)), SplitName.PAPER).test == ()
    with pytest.raises(DatasetError):
        plan_nyu(_listed(range(1000)), SplitName.PAPER)


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


def test_official_split_without_test_pair() -> None:
    with pytest.raises(DatasetError):
        plan_nyu(_listed(range(1, 2)), SplitName.OFFICIAL)


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


def test_val_split_of_too_few_scenes() -> None:
    with pytest.raises(DatasetError):
        plan_nyu(_listed(range(8)), SplitName.VAL)


@pytest.mark.parametrize("bad", ["kitchen", "1449", "-1", ""])
def test_id_that_is_no_label(bad: str) -> None:
    with pytest.raises(DatasetError):
        split_nyu(Listed((bad,), ("a",), ("test",)), SplitName.PAPER)


@given(
    scenes=st.lists(st.text(max_size=3), max_size=40),
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


def test_examples_in_the_docstrings() -> None:
    result = doctest.testmod(splits)
    assert result.attempted > 0
    assert result.failed == 0


@given(st.sets(st.integers(0, 1448)))
def test_compact_ids_are_parsed_back(numbers: set[int]) -> None:
    ids = [f"{number:04d}" for number in numbers]
    assert splits.parse(splits.compact(ids)) == numbers
