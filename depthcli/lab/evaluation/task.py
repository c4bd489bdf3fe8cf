"""The images to evaluate on, runs by seed, and which images a model was trained on."""

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from depthcli.errors import DatasetError, UsageError
from depthcli.lab.datasets import base
from depthcli.lab.datasets.training_data import own_pairs_title
from depthcli.lab.evaluation.protocol import FULL_SIZE_PX
from depthcli.lab.options import SplitName
from depthcli.lab.training.provenance import TrainedRun, common_ids
from depthcli.models.card import ModelCard

TRAIN_SPLIT = "nyu_split"  #: field of a card: the split whose training scenes it was trained on
_NYU_NAME = re.compile(r"0\d{3}|1[0-4]\d\d")
_SEED = re.compile(r"-seed\d+$")


@dataclass(frozen=True, slots=True)
class EvalTask:
    """The images to evaluate on."""

    dataset: base.DepthDataset  #: the pairs
    split: base.Split  #: the split, with all of its pairs that the data set has
    test: tuple[int, ...]  #: positions of the images to evaluate: of the split, or fewer
    title: str = base.NYU  #: name of the data set in tables

    @property
    def is_nyu(self) -> bool:
        """Whether the pairs are those of NYU Depth v2, to which published rows and cards refer."""
        return self.split.name in tuple(SplitName)

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the images to evaluate."""
        return tuple(self.dataset.ids[i] for i in self.test)

    @property
    def scenes(self) -> dict[str, str]:
        """Scene of each image to evaluate, by id; an image of unknown scene is one of its own."""
        scenes = (self.dataset.scenes[i] for i in self.test)
        # Folders that are scenes do not begin with a slash, so no image joins one by its name.
        return {name: scene or f"/{name}" for name, scene in zip(self.ids, scenes, strict=True)}

    def subsampled(self, limit: int | None) -> Self:
        """At most ``limit`` of the images, evenly over the split."""
        if limit is None:
            return self
        count = min(limit, len(self.test))
        chosen = np.linspace(0, len(self.test) - 1, count).round().astype(int)
        return replace(self, test=tuple(self.test[i] for i in chosen))


def plan_nyu(dataset: base.DepthDataset, split: SplitName, limit: int | None = None) -> EvalTask:
    """The test images of a split, or at most ``limit`` of them, evenly over it."""
    divided = base.split_nyu(dataset, split)
    if not divided.test:
        message = f"no pair here belongs to the test part of the {split} split"
        raise DatasetError(message, "give the complete labelled set, or another {split}")
    return EvalTask(dataset, divided, divided.test).subsampled(limit)


def plan_pairs(dataset: base.DepthDataset, title: str, limit: int | None = None) -> EvalTask:
    """All pairs of a custom data set, or at most ``limit`` of them, evenly over it."""
    every = tuple(range(len(dataset)))
    split = base.Split(base.ALL_PAIRS, (), every, 0, len(every))
    return EvalTask(dataset, split, every, title).subsampled(limit)


def plan_runs(
    dataset: base.DepthDataset,
    runs: Sequence[TrainedRun],
    split: SplitName = SplitName.VAL,
    limit: int | None = None,
    title: str = base.NYU,
) -> EvalTask:
    """Choose images that no run was trained on, at most ``limit``, evenly over the split.

    ``val`` is what the runs held out, also of a folder of your own (any other ``title``).
    """
    is_held_out = split is SplitName.VAL
    whole = _held_out(dataset, runs, title) if is_held_out else plan_nyu(dataset, split)
    task = whole.subsampled(limit)
    for run in runs:
        data = run.provenance
        common = common_ids(base.NYU if task.is_nyu else data.data, task.ids, data.seen_ids)
        if common:
            message = f"{run.name} was trained on {len(common)} of the {len(task.ids)} test images"
            raise UsageError(message, "choose another {split}, or omit it")
    return task


def _held_out(dataset: base.DepthDataset, runs: Sequence[TrainedRun], title: str) -> EvalTask:
    first = runs[0]
    parts = first.provenance.train_ids, first.provenance.held_out_ids
    for run in runs:
        if (run.provenance.train_ids, run.provenance.held_out_ids) != parts:
            message = f"{first.name} and {run.name} were trained on or hold out different pairs"
            raise UsageError(message, "compare them separately, or on another {split}")
    if not parts[1]:
        raise UsageError(f"{first.name} held out no pair", "compare on another {split}")
    places = {name: i for i, name in enumerate(dataset.ids)}
    missing = [i for i in (*parts[1], *parts[0]) if i not in places]
    if missing:
        message = f"{len(missing)} pairs of the runs are not here (first: {missing[0]})"
        raise DatasetError(message, "give the data set that they were trained on")
    train, test = (tuple(places[i] for i in ids) for ids in parts)
    name = SplitName.VAL if title == base.NYU else base.HELD_OUT
    return EvalTask(dataset, base.Split(name, train, test, len(train), len(test)), test, title)


def group_by_seed(runs: Iterable[TrainedRun]) -> dict[str, tuple[TrainedRun, ...]]:
    """Runs that differ only in their seed, by their common name: ``cut`` of ``cut-seed0``."""
    groups = defaultdict[str, list[TrainedRun]](list)
    for run in runs:
        groups[_SEED.sub("", run.name)].append(run)
    for members in groups.values():
        settings, seeds = {run.settings for run in members}, {run.config.seed for run in members}
        if len(settings) > 1 or len(seeds) < len(members):
            names = ", ".join(run.name for run in members)
            message = f"{names} are not seeds of one configuration, data and initial weights"
            raise UsageError(message, "rename their folders")
    return {name: tuple(members) for name, members in groups.items()}


def train_overlap(card: ModelCard, task: EvalTask) -> int | None:
    """Number of the images to evaluate that a model was trained on; None if unknown."""
    numbers = trained_numbers(card, task.dataset) if task.is_nyu else None
    return None if numbers is None else sum(int(name) in numbers for name in task.ids)


def train_mark(name: str, card: ModelCard, task: EvalTask, overlap: int | None) -> str:
    """A footnote about a model that was trained on the images to evaluate; "" if it was not."""
    trained = ""
    if overlap:
        trained = f"{overlap} of these images, or on others of their scenes:"
    elif not task.is_nyu and card.training.get("data") == own_pairs_title(Path(task.title)):
        trained = f"a folder {task.title}; if it is this one,"
    elif not task.is_nyu and all(map(_NYU_NAME.fullmatch, task.ids)):
        size_px = task.dataset.depth_m(task.test[0]).shape[::-1]
        numbers = trained_numbers(card, task.dataset) or frozenset()
        count = sum(int(image_id) in numbers for image_id in task.ids)
        if count and size_px == FULL_SIZE_PX:
            trained = f"{count} pairs of NYU Depth v2 with these names; if they are the same,"
    comparable = "its scores say nothing about new images and are not comparable"
    return trained and f"{name} was trained on {trained} {comparable}"


def trained_numbers(card: ModelCard, dataset: base.DepthDataset) -> frozenset[int] | None:
    """Numbers of the pairs that a model, or a run on the split of its card, was trained on.

    None if the card does not state them.
    """
    ranges, split = card.training.get(base.TRAIN_IDS), card.training.get(TRAIN_SPLIT)
    try:
        if isinstance(ranges, str):
            return base.parse(ranges)
        positions = base.split_nyu(dataset, SplitName(str(split))).train
    except (DatasetError, ValueError):
        return None  # ``training`` in a card is free-form
    return frozenset(int(dataset.ids[i]) for i in positions)
