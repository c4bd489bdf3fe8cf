"""The interface of data sets of pictures with measured depth.

Splits of NYU Depth v2 into training and test pairs.

Ids are zero-based label numbers ("0000" to "1448"), as in the labelled set's own order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from itertools import groupby
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Protocol, TypeAlias, runtime_checkable

from depthcli.core.validation import fingerprint
from depthcli.errors import DatasetError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt


class DepthDataset(Protocol):
    """Pairs of a picture and its depth, read one at a time; ``DatasetError`` if that fails."""

    @property
    def ids(self) -> Sequence[str]:
        """Name of each pair, unique."""

    @property
    def scenes(self) -> Sequence[str]:
        """Scene of each pair; "" where it is not known."""

    @property
    def official_split(self) -> Sequence[str]:
        """The data set's own division: "train", "test", or "" where it is not known."""

    def __len__(self) -> int: ...

    def image(self, i: int) -> npt.NDArray[np.uint8]:
        """Picture of pair ``i``: (H, W, 3) RGB uint8."""

    def depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """Depth of pair ``i``: (H, W) float32 metres, 0 where there is none."""


@runtime_checkable
class HasRawDepth(Protocol):
    """A data set that also has depth before in-filling."""

    def raw_depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """Depth of pair ``i`` before filling: (H, W) float32 metres, 0 where nothing was measured.

        Raises:
            DatasetError: it is missing or cannot be read.
        """


@runtime_checkable
class HasFiles(Protocol):
    """A data set that may be made of image files."""

    def files(self, i: int) -> Sequence[Path]:
        """Picture and depth image of pair ``i``, as far as they are files."""


@runtime_checkable
class HasFocalLengths(Protocol):
    """A data set that may know the focal length of each picture."""

    @property
    def focal_px(self) -> Sequence[float]:
        """Focal length of each picture, in its own pixels; empty if they are not known."""


@runtime_checkable
class HasScales(Protocol):
    """A data set whose depth may be scaled to one camera."""

    @property
    def scales(self) -> Sequence[float]:
        """Factor on the metres of each pair; empty for 1."""


@runtime_checkable
class HasCamera(Protocol):
    """A data set whose pictures may have been taken with one known camera."""

    @property
    def hfov_deg(self) -> float | None:
        """Horizontal field of view over the full picture width, degrees; None if not known."""


NYU = "NYU Depth v2"
TRAIN_IDS = "nyu_train_ids"
"""Field of a card's ``training``: pairs of NYU, as :mod:`~depthcli.datasets.base`."""
ALL_PAIRS = "all"
"""Name of the split of a data set without one: all of its pairs are test pairs."""
LABELLED_COUNT = 1449
PAPER_TRAIN_COUNT = 1000
_COUNTS = {"paper": (1000, 449), "official": (795, 654), "val": (866, 134)}


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
    split = _divide(dataset, name)
    if not split.test:
        raise DatasetError(
            f"no pair here belongs to the test part of the {name} split",
            "give the complete labelled set, or another {split}",
        )
    return split


def train_positions(dataset: DepthDataset, name: SplitName) -> tuple[int, ...]:
    """Positions of a split's training pairs in a data set, which need not have test pairs.

    Raises:
        DatasetError: an id is not a label number, or the official split of a pair is not known.
    """
    return _divide(dataset, name).train


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
            f"id {dataset_id!r} is not a label number of NYU Depth v2 (0000 to 1448)",
            "evaluate pairs of your own with 'depthcli eval pairs'",
        )
    return int(dataset_id)


def _divide(dataset: DepthDataset, name: SplitName) -> Split:
    labels = [_label(dataset_id) for dataset_id in dataset.ids]
    counts = _COUNTS[name]
    match name:
        case SplitName.PAPER:
            parts = ["train" if label < PAPER_TRAIN_COUNT else "test" for label in labels]
        case SplitName.OFFICIAL:
            parts = list(dataset.official_split)
            if not {"train", "test"}.issuperset(parts):
                raise DatasetError(
                    "the official split of some pairs is not known: "
                    "give index.csv (id,scene,official_split) with train or test for every pair"
                )
        case SplitName.VAL:
            seen = [s for s, x in zip(dataset.scenes, labels, strict=True) if x < PAPER_TRAIN_COUNT]
            held_out = held_out_scenes(seen)
            parts = [
                "" if label >= PAPER_TRAIN_COUNT else "test" if scene in held_out else "train"
                for scene, label in zip(dataset.scenes, labels, strict=True)
            ]
            if len(seen) == PAPER_TRAIN_COUNT:
                counts = parts.count("train"), parts.count("test")
    train = tuple(i for i, part in enumerate(parts) if part == "train")
    test = tuple(i for i, part in enumerate(parts) if part == "test")
    return Split(name, train, test, *counts)


@dataclass(frozen=True)
class Subset:
    """The pairs at some positions; a :class:`~depthcli.datasets.base.DepthDataset`."""

    whole: DepthDataset  #: the whole data set
    positions: tuple[int, ...]  #: positions of the pairs in it, in their order

    def __len__(self) -> int:
        return len(self.positions)

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """Name of each pair."""
        names = self.whole.ids
        return tuple(names[i] for i in self.positions)

    @property
    def scenes(self) -> tuple[str, ...]:
        """Scene of each pair."""
        scenes = self.whole.scenes
        return tuple(scenes[i] for i in self.positions)

    @property
    def official_split(self) -> tuple[str, ...]:
        """The data set's own division."""
        parts = self.whole.official_split
        return tuple(parts[i] for i in self.positions)

    @property
    def focal_px(self) -> tuple[float, ...]:
        """Focal length of each picture, in its own pixels; empty if they are not known."""
        focal_px = self.whole.focal_px if isinstance(self.whole, HasFocalLengths) else ()
        return tuple(focal_px[i] for i in self.positions) if focal_px else ()

    @property
    def scales(self) -> tuple[float, ...]:
        """Factor on the metres of each pair; empty for 1."""
        scales = self.whole.scales if isinstance(self.whole, HasScales) else ()
        return tuple(scales[i] for i in self.positions) if scales else ()

    @property
    def hfov_deg(self) -> float | None:
        """Horizontal field of view over the full picture width, degrees; None if not known."""
        return self.whole.hfov_deg if isinstance(self.whole, HasCamera) else None

    def files(self, i: int) -> Sequence[Path]:
        """Picture and depth image of pair ``i``, as far as they are files."""
        return self.whole.files(self.positions[i]) if isinstance(self.whole, HasFiles) else ()

    def image(self, i: int) -> npt.NDArray[np.uint8]:
        """Picture of pair ``i``: (H, W, 3) RGB uint8."""
        return self.whole.image(self.positions[i])

    def depth_m(self, i: int) -> npt.NDArray[np.float32]:
        """Depth of pair ``i``: (H, W) float32 metres, 0 where there is none."""
        return self.whole.depth_m(self.positions[i])


def compact(ids: Iterable[str]) -> str:
    """Format ids, whole numbers as in NYU Depth v2, as ranges.

    >>> compact(["0001", "0000", "0002", "0007"])
    '0000-0002,0007'
    """
    numbers = enumerate(sorted({int(name) for name in ids}))
    ranges = []
    for _, run in groupby(numbers, lambda entry: entry[1] - entry[0]):
        first, *rest = (f"{number:04d}" for _, number in run)
        ranges.append(f"{first}-{rest[-1]}" if rest else first)
    return ",".join(ranges)


def parse(text: str) -> frozenset[int]:
    """Parse ranges of ids to numbers.

    Raises:
        ValueError: the text is not a list of ranges.

    >>> sorted(parse("0000-0002,0007"))
    [0, 1, 2, 7]
    """
    numbers: set[int] = set()
    for part in filter(None, text.split(",")):
        first, _, last = part.partition("-")
        numbers.update(range(int(first), int(last or first) + 1))
    return frozenset(numbers)


def data_fingerprint(dataset: DepthDataset) -> str:
    """Checksum of ids, focal lengths and file sizes in bytes; not of the folder's path.

    Of a data set that is not made of image files, such as a .mat file, it has no sizes.

    Raises:
        OSError: a file is missing.
    """
    focal_px = dataset.focal_px if isinstance(dataset, HasFocalLengths) else ()
    sizes: list[list[int]] = []
    if isinstance(dataset, HasFiles):
        files = map(dataset.files, range(len(dataset)))
        sizes = [[file.stat().st_size for file in pair] for pair in files]
    return fingerprint(list(dataset.ids), list(focal_px), sizes)


Opener: TypeAlias = Callable[[Path], DepthDataset]

LAYOUTS = {
    "nyu_depth_v2_labeled.mat": "nyu:open_nyu",
    "index.csv": "nyu:open_nyu",
}
"""Name of a file -> ``module:function`` that opens a folder with it; the first match is used."""


def opener_of(folder: Path) -> Opener | None:
    """The function that opens a folder; None if no file is recognized."""
    for name, entry in LAYOUTS.items():
        if (folder / name).is_file():
            found: Opener = resolve_name(f"depthcli.datasets.{entry}")
            return found
    return None
