"""The interface of data sets of images and depth, splits of NYU Depth v2, ids, and known folders.

Ids of NYU Depth v2 are zero-based label numbers ("0000" to "1448"), in the labelled set's order.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import filterfalse, groupby
from pathlib import Path
from pkgutil import resolve_name
from typing import Self, TypeAlias

from depthcli.core.camera import UNKNOWN_CAMERA, Intrinsics
from depthcli.core.types import Float32Array, Frame, UInt8Array
from depthcli.core.validation import fingerprint
from depthcli.errors import DatasetError
from depthcli.lab.options import SplitName

NYU = "NYU Depth v2"
TRAIN_IDS = "nyu_train_ids"  #: field of a card's ``training``: pairs of NYU, :func:`compact`
ALL_PAIRS = "all"  #: name of the split of a data set without one: all of its pairs are test pairs
HELD_OUT = "held-out"  #: name of the split of pairs of one's own that training runs held out
LABELLED_COUNT = 1449
PAPER_TRAIN_COUNT = 1000
_COUNTS = {"paper": (1000, 449), "official": (795, 654), "val": (866, 134)}


@dataclass(frozen=True, slots=True)
class Pair:
    """An image and its depth, by name."""

    id: str  #: name, unique in its data set
    scene: str = ""  #: "" where it is not known
    official_split: str = ""  #: the data set's own: "train", "val", "test", or "" if not known
    image: Path | None = None  #: file of the image, if it is one
    depth: Path | None = None  #: file of the depth, if it is one
    camera: Intrinsics = UNKNOWN_CAMERA  #: of the image, in its own pixels
    depth_camera: Intrinsics = UNKNOWN_CAMERA  #: of the depth, if it may have one of its own
    scale: float = 1.0  #: factor on the metres, for training a network for one camera
    mask: Path | None = None  #: file that is 0 where the depth does not count


@dataclass(frozen=True)
class DepthDataset(ABC):
    """Pairs of an image and its depth, read one at a time; ``DatasetError`` if that fails."""

    pairs: tuple[Pair, ...]  #: in their order
    #: horizontal field of view of the camera over the full width, degrees; None if not known
    hfov_deg: float | None = field(default=None, kw_only=True)
    #: facts about unit and files that a table states, one line each
    notes: tuple[str, ...] = field(default=(), kw_only=True)
    warnings: tuple[str, ...] = field(default=(), kw_only=True)  #: assumptions, one line each

    def __len__(self) -> int:
        return len(self.pairs)

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """Name of each pair."""
        return tuple(pair.id for pair in self.pairs)

    @cached_property
    def scenes(self) -> tuple[str, ...]:
        """Scene of each pair; "" where it is not known."""
        return tuple(pair.scene for pair in self.pairs)

    @cached_property
    def official_split(self) -> tuple[str, ...]:
        """The data set's own division: "train", "test", or "" where it is not known."""
        return tuple(pair.official_split for pair in self.pairs)

    @cached_property
    def focal_px(self) -> tuple[float, ...]:
        """Focal length of each image, in its own pixels; empty if one is not known."""
        every = (pair.camera.focal_px for pair in self.pairs)
        focals_px = tuple(focal_px for focal_px in every if focal_px is not None)
        return focals_px if len(focals_px) == len(self) else ()

    def files(self, i: int) -> list[Path]:
        """Image, depth and mask of pair ``i``, as far as they are files."""
        pair = self.pairs[i]
        return [path for path in (pair.image, pair.depth, pair.mask) if path]

    def subset(self, positions: Iterable[int]) -> Self:
        """The pairs at some positions, in their order."""
        return replace(self, pairs=tuple(self.pairs[i] for i in positions))

    @abstractmethod
    def image(self, i: int) -> UInt8Array:
        """Image of pair ``i``: (H, W, 3) RGB uint8."""

    def frame(self, i: int) -> Frame:
        """Image of pair ``i`` with what its file states, such as the focal length of EXIF."""
        return Frame(self.image(i))

    @abstractmethod
    def depth_m(self, i: int) -> Float32Array:
        """Depth of pair ``i``: (H, W) float32 metres, 0 where there is none."""

    def raw_depth_m(self, i: int) -> Float32Array:
        """Measured depth of pair ``i``, not filled: (H, W) float32 metres, 0 = none."""
        raise DatasetError(f"there is no raw depth of {self.pairs[i].id}")


@dataclass(frozen=True, slots=True)
class Split:
    """Positions in a data set."""

    name: str  #: a :class:`SplitName`, ``ALL_PAIRS`` or ``HELD_OUT``
    train: tuple[int, ...]  #: positions of the training pairs in the data set
    test: tuple[int, ...]  #: positions of the test pairs in the data set
    train_count: int  #: training pairs of the complete split
    test_count: int  #: test pairs of the complete split


def held_out_scenes(scenes: Sequence[str], every: int = 7, offset: int = 3) -> frozenset[str]:
    """Scenes to hold out: every ``every``-th by name, from ``offset`` on, of each type; never "".

    >>> sorted(held_out_scenes(["a", "b", "b", "c", "d", "e"], every=2, offset=1))
    ['b', 'd']
    """
    return frozenset(sorted(set(scenes))[offset::every]) - {""}


def split_nyu(dataset: DepthDataset, name: SplitName) -> Split:
    """Divide a data set whose ids are label numbers; the test part may be empty."""
    for dataset_id in filterfalse(is_label, dataset.ids):
        message = f"id {dataset_id!r} is not a label number of NYU Depth v2 (0000 to 1448)"
        raise DatasetError(message, "evaluate pairs of your own with 'depthcli eval pairs'")
    labels, counts = map(int, dataset.ids), _COUNTS[name]
    parts = ["train" if label < PAPER_TRAIN_COUNT else "test" for label in labels]
    if name is SplitName.OFFICIAL:
        parts = list(dataset.official_split)
        if not {"train", "test"}.issuperset(parts):
            advice = "give index.csv (id,scene,official_split) with train or test for each pair"
            raise DatasetError("the official split of some pairs is not known", advice)
    elif name is SplitName.VAL:
        numbered = list(zip(dataset.scenes, parts, strict=True))
        scenes = [scene for scene, part in numbered if part == "train"]
        held_out = held_out_scenes(scenes)
        parts = [
            "" if part == "test" else "test" if scene in held_out else "train"
            for scene, part in numbered
        ]
        if len(scenes) == PAPER_TRAIN_COUNT:
            counts = parts.count("train"), parts.count("test")
    train, test = (
        tuple(i for i, part in enumerate(parts) if part == half) for half in ("train", "test")
    )
    return Split(name, train, test, *counts)


def is_label(dataset_id: str) -> bool:
    """Whether an id is a label number of NYU Depth v2."""
    return dataset_id.isdecimal() and int(dataset_id) < LABELLED_COUNT


def label_id(dataset_id: str) -> str:
    """A label number of NYU Depth v2 with four digits, other ids as they are.

    >>> label_id("7"), label_id("0007"), label_id("a7")
    ('0007', '0007', 'a7')
    """
    return f"{int(dataset_id):04d}" if is_label(dataset_id) else dataset_id


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
    """Parse ranges of ids to numbers; ValueError if they are none.

    >>> sorted(parse("0000-0002,0007"))
    [0, 1, 2, 7]
    """
    numbers: set[int] = set()
    for part in filter(None, text.split(",")):
        first, _, last = part.partition("-")
        numbers.update(range(int(first), int(last or first) + 1))
    return frozenset(numbers)


def data_fingerprint(dataset: DepthDataset) -> str:
    """Checksum of ids, focal lengths and sizes of image files, if there are any, not of paths."""
    sizes = [[file.stat().st_size for file in dataset.files(i)] for i in range(len(dataset))]
    return fingerprint(list(dataset.ids), list(dataset.focal_px), sizes if any(sizes) else [])


Opener: TypeAlias = Callable[[Path], DepthDataset]

OPENERS = {
    "nyu_depth_v2_labeled.mat": "nyu:open_nyu",
    "index.csv": "nyu:open_nyu",
}
"""Name of a file -> ``module:function`` that opens a folder with it; the first match is used."""


def opener_of(folder: Path) -> Opener | None:
    """The function that opens a folder; None if no file is recognized."""
    for name, entry in OPENERS.items():
        if (folder / name).is_file():
            return resolve_name(f"depthcli.lab.datasets.{entry}")  # type: ignore[no-any-return]
    return None
