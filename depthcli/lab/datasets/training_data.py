"""Opening training data: the training part of NYU Depth v2, or a folder of your own."""

from pathlib import Path
from typing import Literal, NamedTuple

from depthcli.core.options import MILLIMETRES
from depthcli.errors import DatasetError, Message
from depthcli.io.stored.depth import AS_STATED, DepthReadOptions
from depthcli.lab.datasets import folders, layouts, nyu
from depthcli.lab.datasets.base import PAPER_TRAIN_COUNT, DepthDataset, opener_of

NYU_HFOV_DEG = 63.3  #: horizontal field of view of NYU Depth v2's camera, degrees
NYU_ASPECT = 4 / 3  #: width over height of NYU Depth v2's images
NYU_PAPER = "NYU Depth v2, labelled pairs 1-1000"
NYU_OFFICIAL = "NYU Depth v2, the official split's training pairs"


def own_pairs_title(folder: Path) -> str:
    """The name of a folder of one's own pairs in a model's card."""
    return f"own pairs ({folder.resolve().name})"


class TrainingData(NamedTuple):
    """The data of a training run."""

    dataset: DepthDataset  #: every pair that may be trained on or held out
    title: str  #: its name in a model's card
    #: horizontal field of view of its camera in degrees; None if it is not known
    hfov_deg: float | None
    #: pairs with less accurate depth, such as predictions; None if there are none
    pseudo_labels: folders.FolderDataset | None = None

    def with_pseudo_labels(self, pseudo_labels: folders.FolderDataset) -> "TrainingData":
        """Add further pairs, scaled to this data's camera if their focal lengths are known."""
        labels = pseudo_labels.with_stated_focal_px()
        if labels.focal_px:
            labels = labels.for_camera(self.hfov_deg or NYU_HFOV_DEG, self.aspect)
        return self._replace(pseudo_labels=labels)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Assumptions about its files, one line each, in the words of the settings."""
        texts = self.dataset.warnings
        messages = (text if isinstance(text, Message) else Message(text) for text in texts)
        return tuple(
            Message(message.problem, message.advice.replace("{png_scale}", "data.units_per_metre"))
            for message in messages
        )

    @property
    def aspect(self) -> float:
        """Width over height of the first image."""
        height, width = self.dataset.image(0).shape[:2]
        return float(width / height)


def open_training_data(
    path: Path,
    split: Literal["paper", "official"] = "paper",
    units_per_metre: float = MILLIMETRES,
    patterns: tuple[str, str] | None = None,
    *,
    paired: bool,
) -> TrainingData:
    """Open a data set to train on: NYU Depth v2, another of ``OPENERS``, or pairs of your own.

    If images need not be ``paired`` with depth, they may differ in names and sizes. Of your own
    pairs, whose depth has ``units_per_metre``, the ``official`` split is what an index.csv calls
    "train", and ``paper`` is all of them.
    """
    path = nyu.located_nyu(path)
    reading = DepthReadOptions(scale=None if units_per_metre == MILLIMETRES else units_per_metre)
    if not (patterns or path.suffix == ".txt") and (not path.is_dir() or nyu.is_nyu(path)):
        _refuse_unit(path, reading)
        if (path / folders.CAMERAS_NAME).is_file():
            advice = f"remove {folders.CAMERAS_NAME}, or rename the pairs if they are your own"
            raise DatasetError(
                f"{path} has the ids of NYU Depth v2, whose camera is known: {advice}"
            )
        title = NYU_OFFICIAL if split == "official" else NYU_PAPER
        data = TrainingData(nyu.open_nyu(path), title, NYU_HFOV_DEG)
    elif not (paired or opener_of(path) or _are_pairs(path, patterns)):
        lists = folders.open_unpaired_folder(path, reading, patterns)
        title = f"own images and depth, unpaired ({path.resolve().name})"
        data = TrainingData(lists, title, None)
    else:
        dataset = open_pairs(path, reading, patterns)
        data = TrainingData(dataset, own_pairs_title(path), dataset.hfov_deg)
    part = _training_part(data, split)
    data = data._replace(dataset=part)
    if data.hfov_deg is None and isinstance(part, folders.FolderDataset) and part.focal_px:
        part = part.for_camera(NYU_HFOV_DEG, data.aspect)
        data = data._replace(dataset=part, hfov_deg=NYU_HFOV_DEG)
    return data


def open_pairs(
    path: Path, reading: DepthReadOptions = AS_STATED, patterns: tuple[str, str] | None = None
) -> DepthDataset:
    """Open pairs of one's own; of a folder with an index.csv, or of another of the layouts."""
    opener = opener_of(path)
    if opener is None or patterns:
        return folders.open_paired_folder(path, reading, patterns=patterns)
    if opener is nyu.open_nyu:
        return nyu.open_indexed_folder(path, reading)
    _refuse_unit(path, reading)
    return opener(path)


def _refuse_unit(path: Path, reading: DepthReadOptions) -> None:
    if reading.scale is not None:
        advice = "remove {png_scale} ('eval pairs') or data.units_per_metre ('train')"
        raise DatasetError(f"{path} is a data set whose unit is known", advice)


def _are_pairs(path: Path, patterns: tuple[str, str] | None) -> bool:
    """Whether images and depth are named in pairs, and the first is of one view."""
    try:
        pair = layouts.list_pairs(path, patterns).pairs[0]
    except DatasetError:
        return False
    dataset = folders.FolderDataset((pair,), path)
    return dataset.image(0).shape[:2] == dataset.stored(0).depth.values.shape


def _training_part(data: TrainingData, split: str) -> DepthDataset:
    """The training pairs of a split: of pairs of one's own, all but for ``official``."""
    whole = data.dataset
    if split == "official":
        rows = [i for i, part in enumerate(whole.official_split) if part == "train"]
    elif data.title == NYU_PAPER:
        rows = [i for i, name in enumerate(whole.ids) if int(name) < PAPER_TRAIN_COUNT]
    else:
        return whole
    if not rows:
        advice = "give the complete set, an index.csv with the split, or another data.split"
        raise DatasetError(f"no pair here is in the training part of the {split} split", advice)
    return whole.subset(rows)
