"""Opening training data: the training part of NYU Depth v2, or a folder of your own."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple

from depthcli.datasets.base import PAPER_TRAIN_COUNT, DepthDataset, HasCamera, Subset, opener_of
from depthcli.datasets.folders import (
    CAMERAS_NAME,
    DEPTH_SUFFIXES,
    IMAGE_SUFFIXES,
    PairedFolder,
    depth_shape,
    list_files,
    open_paired_folder,
    open_picture_folder,
    open_unpaired_folder,
    read_image_rgb,
    stated_focal_px,
)
from depthcli.datasets.nyu import has_own_index, open_indexed_folder, open_nyu
from depthcli.errors import DatasetError
from depthcli.io.formats.table import MILLIMETRES

NYU_HFOV_DEG = 63.3
"""Horizontal field of view of NYU Depth v2's camera over the full picture width, degrees."""
NYU_ASPECT = 4 / 3
"""Width over height of NYU Depth v2's pictures."""
NYU_PAPER = "NYU Depth v2, labelled pairs 1-1000"
NYU_OFFICIAL = "NYU Depth v2, the official split's training pairs"

OWN_PAIRS, OWN_PICTURES = "own pairs (", "own pictures ("
"""What the names of folders of one's own begin with: of pairs, and of pictures alone."""


def own_pairs_title(folder: Path) -> str:
    """The name of a folder of one's own pairs in a model's card."""
    return f"{OWN_PAIRS}{folder.resolve().name})"


class TrainingData(NamedTuple):
    """The data of a training run."""

    dataset: DepthDataset  #: every pair that may be trained on or held out
    title: str  #: its name in a model's card
    #: horizontal field of view of its camera in degrees; None if it is not known
    hfov_deg: float | None
    #: pairs with less accurate depth, such as predictions; None if there are none
    pseudo_labels: PairedFolder | None = None

    def with_pseudo_labels(self, pseudo_labels: PairedFolder) -> "TrainingData":
        """Add further pairs, scaled to this data's camera if their focal lengths are known.

        Those of cameras.csv, else those that the depth images state.

        Raises:
            DatasetError: only some of the depth images state theirs, or one cannot be read.
        """
        focal_px = pseudo_labels.focal_px or stated_focal_px(pseudo_labels.depths)
        if focal_px:
            known = replace(pseudo_labels, focal_px=focal_px)
            pseudo_labels = known.for_camera(self.hfov_deg or NYU_HFOV_DEG, self.aspect)
        return self._replace(pseudo_labels=pseudo_labels)

    @property
    def pseudo_labels_title(self) -> str:
        """Name of the pseudo labels in a model's card; "" if there are none."""
        if self.pseudo_labels is None:
            return ""
        return f"{len(self.pseudo_labels)} pseudo labels ({self.pseudo_labels.root.resolve().name})"

    @property
    def aspect(self) -> float:
        """Width over height of the first picture."""
        height, width = self.dataset.image(0).shape[:2]
        return float(width / height)


def open_training_data(
    path: Path,
    *,
    paired: bool,
    depth: bool = True,
    split: Literal["paper", "official"] = "paper",
    units_per_metre: float = MILLIMETRES,
) -> TrainingData:
    """Open a data set to train on.

    Args:
        path: NYU Depth v2, as :func:`~depthcli.datasets.nyu.open_nyu` takes it, of which only the
            training part is used; another folder of
            :data:`~depthcli.datasets.base.LAYOUTS`; or a folder of ``rgb/`` and ``depth/`` with
            other names than NYU's numbers, whose subfolders are the scenes if it has no index.csv.
        paired: whether each picture needs its depth. If not, and names or sizes in the two folders
            differ, they are opened as unpaired.
        depth: whether depth is needed; if not, any folder of pictures will do.
        split: of NYU Depth v2, whose training part is used. Of other data, ``official`` is what the
            data itself names "train", and ``paper`` is all of it.
        units_per_metre: value of one metre in the depth images of a folder of your own.

    Raises:
        DatasetError: the data is missing, incomplete, damaged, or in another unit.
    """
    opener = opener_of(path) if path.is_dir() else open_nyu
    if opener is None or (opener is open_nyu and has_own_index(path)):
        indexed = opener is not None
        return _own_folder(path, indexed, paired, depth, split, units_per_metre)
    if units_per_metre != MILLIMETRES:
        raise DatasetError(f"{path} is a data set whose unit is known: remove data.units_per_metre")
    whole = opener(path)
    if opener is open_nyu:
        if (path / CAMERAS_NAME).is_file():
            raise DatasetError(
                f"{path} has the ids of NYU Depth v2, whose camera is known: remove "
                f"{CAMERAS_NAME}, or rename the pairs if they are your own"
            )
        return _training_part(whole, split)
    hfov_deg = whole.hfov_deg if isinstance(whole, HasCamera) else None
    return TrainingData(_own_part(whole, split), own_pairs_title(path), hfov_deg)


def _own_folder(
    path: Path, indexed: bool, paired: bool, depth: bool, split: str, units_per_metre: float
) -> TrainingData:
    """A folder of one's own; if it has an index, its pairs."""
    title = path.resolve().name
    if not (depth or indexed):
        pictures = _own_part(open_picture_folder(path), split)
        return TrainingData(pictures, f"{OWN_PICTURES}{title})", None)
    if not (paired or indexed or _are_matching(path)):
        lists = _own_part(open_unpaired_folder(path, units_per_metre=units_per_metre), split)
        return TrainingData(lists, f"own pictures and depth, unpaired ({title})", None)
    opener = open_indexed_folder if indexed else open_paired_folder
    pairs = opener(path, units_per_metre=units_per_metre)
    data = TrainingData(_own_part(pairs, split), own_pairs_title(path), None)
    if not pairs.focal_px:
        return data
    scaled = _own_part(pairs.for_camera(NYU_HFOV_DEG, data.aspect), split)
    return data._replace(dataset=scaled, hfov_deg=NYU_HFOV_DEG)


def _own_part(whole: DepthDataset, split: str) -> DepthDataset:
    """All pairs, or of the official split those that the data itself names "train"."""
    if split != "official":
        return whole
    rows = [i for i, part in enumerate(whole.official_split) if part == "train"]
    return _subset_or_all(whole, rows, split)


def _training_part(whole: DepthDataset, split: str) -> TrainingData:
    """The training pairs of a split."""
    if split == "official":
        return TrainingData(_own_part(whole, split), NYU_OFFICIAL, NYU_HFOV_DEG)
    rows = [i for i, name in enumerate(whole.ids) if int(name) < PAPER_TRAIN_COUNT]
    return TrainingData(_subset_or_all(whole, rows, split), NYU_PAPER, NYU_HFOV_DEG)


def _subset_or_all(whole: DepthDataset, rows: Sequence[int], split: str) -> DepthDataset:
    if not rows:
        raise DatasetError(
            f"no pair here belongs to the training part of the {split} split: give the complete "
            "labelled set, an index.csv with the split, or another data.split"
        )
    return whole if len(rows) == len(whole) else Subset(whole, tuple(rows))


def _are_matching(path: Path) -> bool:
    """Whether pictures and depth have the same names and, in the first of them, the same size."""
    images = list_files(path, "rgb", IMAGE_SUFFIXES)
    depths = list_files(path, "depth", DEPTH_SUFFIXES)
    if images.keys() != depths.keys():
        return False
    first = min(images)
    return read_image_rgb(images[first]).shape[:2] == depth_shape(depths[first])
