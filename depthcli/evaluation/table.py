"""Making a table of scores: published rows, trivial rows and the predictors to compare."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.datasets.base import DepthDataset
from depthcli.datasets.splits import ALL_PAIRS, NYU, Split, SplitName, split_nyu
from depthcli.evaluation.predictors.base import Predictor
from depthcli.evaluation.predictors.trivial import fit_trivial
from depthcli.evaluation.protocol import HEADLINE, EvalProtocol
from depthcli.evaluation.published import PUBLISHED
from depthcli.evaluation.report import EvalReport, ReportRow
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


def evaluate_models(
    task: EvalTask,
    predictors: Sequence[Predictor],
    options: EvalOptions = HEADLINE_TABLE,
    progress: Progress = NO_PROGRESS,
) -> EvalReport:
    """Make the table.

    Raises:
        DatasetError: a pair cannot be read or does not fit the protocol.
        UsageError: no alignment suits a predictor.
    """
    rows = score_rows(task, predictors, options, progress)
    comparable = task.split.name == SplitName.PAPER and options.protocol.is_headline
    return EvalReport(
        dataset=task.title,
        split=task.split.name,
        image_count=len(task.test),
        split_count=task.split.test_count,
        train_count=len(task.split.train) if options.trivial else 0,
        protocol=options.protocol,
        rows=(*(PUBLISHED if comparable else ()), *rows),
        notes=tuple(_notes(task, comparable=comparable, trivial=options.trivial)),
    )


def score_rows(
    task: EvalTask, predictors: Sequence[Predictor], options: EvalOptions, progress: Progress
) -> tuple[ReportRow, ...]:
    """The rows of trivial baselines and predictors; arguments and errors as evaluate_models."""
    entries = []
    for predictor in predictors:
        learned = train_overlap(predictor, task.dataset, task.ids) if task.is_nyu else None
        entries.append(entry_for(predictor, options.alignments, learned))
    if options.trivial and task.split.train:
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


def _notes(task: EvalTask, *, comparable: bool, trivial: bool) -> list[str]:
    notes = []
    if task.is_nyu and not comparable:
        notes.append(
            "the paper's rows belong to the paper split and the headline protocol and are "
            "omitted here"
        )
    return [*notes, *(trivial_notes(task.split) if trivial else ())]


def trivial_notes(split: Split) -> list[str]:
    """Notes on missing training pairs for the trivial rows."""
    if not split.train:
        return ["no training pair of this split is available: baselines are omitted"]
    if len(split.train) != split.train_count:
        known = f"{len(split.train)} of the split's {split.train_count} training pairs"
        return [f"the mean rows were computed from {known}"]
    return []
