"""Scoring the rows of a table: trivial rows and the predictors to compare."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Self

import numpy as np

from depthcli.core.progress import Progress
from depthcli.datasets.base import DepthDataset
from depthcli.datasets.splits import ALL_PAIRS, NYU, Split, SplitName, split_nyu
from depthcli.evaluation.bootstrap import differences_from
from depthcli.evaluation.differences import Difference
from depthcli.evaluation.predictors.base import Predictor
from depthcli.evaluation.predictors.trivial import fit_trivial
from depthcli.evaluation.protocol import HEADLINE, EvalProtocol
from depthcli.evaluation.report import ReportRow
from depthcli.evaluation.run import Entry, entry_for, evaluate
from depthcli.evaluation.train_overlap import train_overlap
from depthcli.metrics.choices import Alignment


@dataclass(frozen=True, slots=True)
class EvalOptions:
    """Options of a table."""

    protocol: EvalProtocol = HEADLINE  #: how prediction and ground truth are compared
    #: a row for each that suits a predictor; trivial rows also have none and median
    alignments: tuple[Alignment, ...] = (Alignment.NONE,)
    trivial: bool = True  #: include baselines that ignore the picture
    per_image: bool = False  #: keep the scores of each image
    workers: int = 0  #: images processed in parallel; 0 for the calling thread


HEADLINE_TABLE = EvalOptions()


@dataclass(frozen=True, slots=True)
class EvalTask:
    """The images to evaluate on."""

    dataset: DepthDataset  #: the pairs
    split: Split  #: the split, with all of its pairs that the data set has
    #: positions of the images to evaluate: all test images of the split, or fewer
    test: tuple[int, ...]
    title: str = NYU  #: name of the data set in tables

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

    def has_trivial(self, options: EvalOptions) -> bool:
        """Whether the table has rows that ignore the picture."""
        return options.trivial and bool(self.split.train)

    def subsampled(self, limit: int | None) -> Self:
        """The same with at most ``limit`` images, evenly over the split."""
        if limit is None:
            return self
        count = min(limit, len(self.test))
        chosen = np.linspace(0, len(self.test) - 1, count).round().astype(int)
        return replace(self, test=tuple(self.test[i] for i in chosen))


def plan_nyu(dataset: DepthDataset, split: SplitName, limit: int | None = None) -> EvalTask:
    """The test images of a split, or at most ``limit`` of them, evenly over it.

    Raises:
        DatasetError: the data set has no test image of the split.
    """
    divided = split_nyu(dataset, split)
    return EvalTask(dataset, divided, divided.test).subsampled(limit)


def plan_pairs(dataset: DepthDataset, title: str, limit: int | None = None) -> EvalTask:
    """All pairs of a custom data set, or at most ``limit`` of them, evenly over it."""
    every = tuple(range(len(dataset)))
    split = Split(ALL_PAIRS, (), every, 0, len(every))
    return EvalTask(dataset, split, every, title).subsampled(limit)


def compare_rows(
    task: EvalTask,
    predictors: Sequence[Predictor],
    options: EvalOptions,
    progress: Progress,
    against: str | None,
    group_of: Mapping[str, str] = MappingProxyType({}),
) -> tuple[tuple[ReportRow, ...], tuple[Difference, ...]]:
    """The rows of trivial baselines and predictors, and the differences of one from every other.

    Rows of the same ``group_of`` are averaged for the differences. ``against`` names the one row
    or group; None for no differences. Other arguments and errors are those of evaluate_models.
    """
    kept = options.per_image or against is not None
    rows = _score_rows(task, predictors, replace(options, per_image=kept), progress)
    if against is None:
        return rows, ()
    groups: dict[str, list[ReportRow]] = {}
    for row in rows:
        groups.setdefault(group_of.get(row.name, row.name), []).append(row)
    differences = differences_from(against, groups, task.scenes)
    return rows if options.per_image else tuple(replace(r, images=()) for r in rows), differences


def _score_rows(
    task: EvalTask, predictors: Sequence[Predictor], options: EvalOptions, progress: Progress
) -> tuple[ReportRow, ...]:
    entries = []
    for predictor in predictors:
        learned = train_overlap(predictor, task.dataset, task.ids) if task.is_nyu else None
        entries.append(entry_for(predictor, options.alignments, learned))
    if task.has_trivial(options):
        entries = [*_trivial_entries(task, options, progress), *entries]
    return evaluate(
        task.dataset,
        task.test,
        entries,
        options.protocol,
        per_image=options.per_image,
        progress=progress,
        workers=options.workers,
    )


def _trivial_entries(task: EvalTask, options: EvalOptions, progress: Progress) -> list[Entry]:
    means = fit_trivial(
        task.dataset,
        task.split.train,
        min_m=options.protocol.min_m,
        max_m=options.protocol.max_m,
        progress=progress,
        workers=options.workers,
    )
    wanted = (Alignment.NONE, Alignment.MEDIAN, *options.alignments)
    return [entry_for(mean, wanted) for mean in means]


def trivial_notes(split: Split) -> list[str]:
    """Notes on missing training pairs for the trivial rows."""
    if not split.train:
        return ["no training pair of this split is available: baselines are omitted"]
    if len(split.train) != split.train_count:
        known = f"{len(split.train)} of the split's {split.train_count} training pairs"
        return [f"the mean rows were computed from {known}"]
    return []
