"""Splits of NYU Depth v2 into training and test pairs.

Ids are zero-based label numbers ("0000" to "1448"), as in the labelled set's own order.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from depthcli.datasets.base import DepthDataset
from depthcli.errors import DatasetError

NYU = "NYU Depth v2"
TRAIN_IDS = "nyu_train_ids"
"""Field of a card's ``training``: pairs of NYU, as :mod:`~depthcli.datasets.id_ranges`."""
ALL_PAIRS = "all"
"""Name of the split of a data set without one: all of its pairs are test pairs."""
LABELLED_COUNT = 1449
PAPER_TRAIN_COUNT = 1000
OFFICIAL_TRAIN_COUNT = 795
VAL_TRAIN_COUNT = 866


class SplitName(StrEnum):
    """The ways to divide the labelled set."""

    PAPER = "paper"
    """Pairs 1–1000 for training, 1001–1449 for testing; no scene is in both."""
    OFFICIAL = "official"
    """The data set's own 795 / 654 pairs, as in most of the literature."""
    VAL = "val"
    """Pairs 1–1000 only: every seventh scene for testing, the others for training."""


@dataclass(frozen=True, slots=True)
class Split:
    """Positions in a data set."""

    name: str  #: a :class:`SplitName`, or ``ALL_PAIRS``
    train: tuple[int, ...]  #: positions of the training pairs in the data set
    test: tuple[int, ...]  #: positions of the test pairs in the data set
    train_count: int  #: training pairs of the complete split
    test_count: int  #: test pairs of the complete split


def held_out_scenes(scenes: Sequence[str], every: int = 7, offset: int = 3) -> frozenset[str]:
    """Scenes that are held out from training: every ``every``-th by name, from ``offset`` on.

    Names begin with the type of the scene, so types with many scenes are represented. Pairs whose
    scene is not known ("") are not held out.

    >>> sorted(held_out_scenes(["a", "b", "b", "c", "d", "e"], every=2, offset=1))
    ['b', 'd']
    """
    return frozenset(sorted(set(scenes))[offset::every]) - {""}


def split_nyu(dataset: DepthDataset, name: SplitName) -> Split:
    """Divide a data set whose ids are label numbers.

    Raises:
        DatasetError: an id is not a label number, or the split has no test pair here.
    """
    labels = [_label(dataset_id) for dataset_id in dataset.ids]
    split = _SPLITTERS[name](dataset, labels)
    if not split.test:
        raise DatasetError(_NOTHING_TO_TEST[name])
    return split


def train_positions(dataset: DepthDataset, name: SplitName) -> tuple[int, ...]:
    """Positions of a split's training pairs in a data set, which need not have test pairs.

    Raises:
        DatasetError: an id is not a label number, or the official split of a pair is not known.
    """
    return _SPLITTERS[name](dataset, [_label(dataset_id) for dataset_id in dataset.ids]).train


def is_label(dataset_id: str) -> bool:
    """Whether an id is a label number of NYU Depth v2."""
    return dataset_id.isdecimal() and int(dataset_id) < LABELLED_COUNT


def label_id(dataset_id: str) -> str:
    """A label number of NYU Depth v2 with four digits, other ids as they are.

    >>> label_id("7"), label_id("0007"), label_id("a7")
    ('0007', '0007', 'a7')
    """
    return f"{int(dataset_id):04d}" if is_label(dataset_id) else dataset_id


def _label(dataset_id: str) -> int:
    if not is_label(dataset_id):
        raise DatasetError(
            f"id {dataset_id!r} is not a label number of NYU Depth v2 (0000 to "
            f"{LABELLED_COUNT - 1}): evaluate pairs of your own with 'depthcli eval pairs'"
        )
    return int(dataset_id)


def _paper(dataset: DepthDataset, labels: Sequence[int]) -> Split:
    del dataset
    train = tuple(i for i, label in enumerate(labels) if label < PAPER_TRAIN_COUNT)
    test = tuple(i for i, label in enumerate(labels) if label >= PAPER_TRAIN_COUNT)
    test_count = LABELLED_COUNT - PAPER_TRAIN_COUNT
    return Split(SplitName.PAPER, train, test, PAPER_TRAIN_COUNT, test_count)


def _official(dataset: DepthDataset, labels: Sequence[int]) -> Split:
    named = dataset.official_split
    unknown = [dataset.ids[i] for i in range(len(labels)) if named[i] not in {"train", "test"}]
    if unknown:
        raise DatasetError(
            f"the official split of {len(unknown)} pairs (first: {unknown[0]}) is not known: "
            "give index.csv (id,scene,official_split) with train or test for every pair"
        )
    train = tuple(i for i, part in enumerate(named) if part == "train")
    test = tuple(i for i, part in enumerate(named) if part == "test")
    test_count = LABELLED_COUNT - OFFICIAL_TRAIN_COUNT
    return Split(SplitName.OFFICIAL, train, test, OFFICIAL_TRAIN_COUNT, test_count)


def _val(dataset: DepthDataset, labels: Sequence[int]) -> Split:
    candidates = [i for i, label in enumerate(labels) if label < PAPER_TRAIN_COUNT]
    held_out = held_out_scenes([dataset.scenes[i] for i in candidates])
    train = tuple(i for i in candidates if dataset.scenes[i] not in held_out)
    test = tuple(i for i in candidates if dataset.scenes[i] in held_out)
    is_whole = len(candidates) == PAPER_TRAIN_COUNT
    train_count = len(train) if is_whole else VAL_TRAIN_COUNT
    return Split(SplitName.VAL, train, test, train_count, PAPER_TRAIN_COUNT - train_count)


_SPLITTERS: dict[SplitName, Callable[[DepthDataset, Sequence[int]], Split]] = {
    SplitName.PAPER: _paper,
    SplitName.OFFICIAL: _official,
    SplitName.VAL: _val,
}

_NOTHING_TO_TEST = {
    SplitName.PAPER: "the paper split tests on pairs 1001-1449 and none of them is here: "
    "use --split val, or give the complete labelled set",
    SplitName.OFFICIAL: "no pair here belongs to the test part of the official split: "
    "use --split val, or give the complete labelled set",
    SplitName.VAL: "too few scenes among pairs 1-1000 to hold any out: give the data set's first "
    "1000 pairs",
}
