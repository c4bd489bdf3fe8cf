"""Making the table of models: published rows, trivial rows and the predictors to compare."""

from collections.abc import Sequence

from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.datasets.splits import SplitName
from depthcli.evaluation.predictors.base import Predictor
from depthcli.evaluation.published import PUBLISHED
from depthcli.evaluation.report import EvalReport
from depthcli.evaluation.table import (
    HEADLINE_TABLE,
    EvalOptions,
    EvalTask,
    compare_rows,
    trivial_notes,
)


def evaluate_models(
    task: EvalTask,
    predictors: Sequence[Predictor],
    options: EvalOptions = HEADLINE_TABLE,
    progress: Progress = NO_PROGRESS,
    *,
    against: str | None = None,
) -> EvalReport:
    """Make the table; with ``against``, also the paired differences of this row from every other.

    Raises:
        DatasetError: a pair cannot be read or does not fit the protocol.
        UsageError: no alignment suits a predictor.
    """
    rows, differences = compare_rows(task, predictors, options, progress, against)
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
        differences=differences,
    )


def _notes(task: EvalTask, *, comparable: bool, trivial: bool) -> list[str]:
    notes = []
    if task.is_nyu and not comparable:
        notes.append(
            "the paper's rows belong to the paper split and the headline protocol and are "
            "omitted here"
        )
    if task.split.name == SplitName.VAL and len(task.split.test) != task.split.test_count:
        notes.append(
            "not all of pairs 1-1000 are here, so the held-out scenes are not those of all of them"
        )
    return [*notes, *(trivial_notes(task.split) if trivial else ())]
