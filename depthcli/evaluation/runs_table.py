"""Making the table of training runs: mean and standard deviation over seeds, cost, baselines."""

from collections.abc import Sequence

from depthcli.core.choices import Weights
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.datasets.splits import SplitName
from depthcli.evaluation.published import PUBLISHED, PUBLISHED_COUNT
from depthcli.evaluation.report import ReportRow
from depthcli.evaluation.runs_report import RunsReport, RunsRow, Training
from depthcli.evaluation.table import (
    HEADLINE_TABLE,
    EvalOptions,
    EvalTask,
    compare_rows,
    trivial_notes,
)
from depthcli.evaluation.trained import TrainedModel, group_by_seed, mean_and_std
from depthcli.metrics.accumulate import Scores
from depthcli.metrics.choices import Alignment
from depthcli.metrics.depth import METRICS

_RAW = "weights of the last step, not their moving average"
_TABLE_ORDER = [row.name.removesuffix(" (paper)").lower() for row in PUBLISHED]


def evaluate_runs(
    task: EvalTask,
    models: Sequence[TrainedModel],
    options: EvalOptions = HEADLINE_TABLE,
    progress: Progress = NO_PROGRESS,
    *,
    published: bool = True,
    weights: Weights = Weights.AVERAGED,
    against: str | None = None,
) -> RunsReport:
    """Make the table on a task from ``plan_comparison``: pictures that no run was trained on.

    With ``against``, this row is also compared with every other by paired differences.

    Raises:
        DatasetError: a pair cannot be read or does not fit the protocol.
        UsageError: runs of one name differ in more than their seed.
    """
    by_name = {model.run.name: model for model in models}
    groups = {
        name: [by_name[run.name] for run in members]
        for name, members in group_by_seed([model.run for model in models]).items()
    }
    group_of = {member.run.name: name for name, members in groups.items() for member in members}
    predictors = [model.predictor for model in models]
    scored, differences = compare_rows(task, predictors, options, progress, against, group_of)
    rows = [RunsRow(row) for row in scored if row.name not in by_name]
    rows += [
        _row_of_seeds(name, groups[name], scored, alignment)
        for name in sorted(groups, key=_table_order)
        for alignment in dict.fromkeys(options.alignments)
    ]
    rows += [RunsRow(row) for row in PUBLISHED if published]
    return RunsReport(
        dataset=task.title,
        split=task.split.name,
        image_count=len(task.test),
        split_count=task.split.test_count,
        train_count=len(task.split.train) if options.trivial else 0,
        protocol=options.protocol,
        rows=tuple(rows),
        notes=(
            *_runs_notes(task, models, trivial=options.trivial, published=published),
            *([_RAW] if weights is Weights.RAW else []),
        ),
        differences=differences,
    )


def _table_order(name: str) -> tuple[int, str]:
    """Sort key: the paper's order, then by name."""
    known = name in _TABLE_ORDER
    return (_TABLE_ORDER.index(name) if known else len(_TABLE_ORDER), name)


def _row_of_seeds(
    name: str, members: Sequence[TrainedModel], scored: Sequence[ReportRow], alignment: Alignment
) -> RunsRow:
    """One line with mean and standard deviation over the seeds of a method."""
    names = {member.run.name for member in members}
    rows = [row for row in scored if row.name in names and row.alignment is alignment]
    columns = {metric: [row.scores[metric] for row in rows] for metric in METRICS}
    means_and_stds = {metric: mean_and_std(values) for metric, values in columns.items()}
    stds = {metric: std for metric, (_, std) in means_and_stds.items() if std is not None}
    mean = ReportRow(
        name=name,
        source=rows[0].source,
        alignment=alignment,
        image_count=rows[0].image_count,
        scores=Scores.of(**{metric: mean for metric, (mean, _) in means_and_stds.items()}),
        empty_count=rows[0].empty_count,
        note="; ".join(dict.fromkeys(row.note for row in rows if row.note)),
    )
    return RunsRow(mean, Scores.of(**stds) if stds else None, _training_of(members), tuple(rows))


def _training_of(members: Sequence[TrainedModel]) -> Training:
    runs = [member.run for member in members]
    return Training(
        seeds=tuple(run.seed for run in runs),
        paired=runs[0].paired,
        parameters=runs[0].parameters,
        latency_ms=mean_and_std([member.latency_ms for member in members])[0],
        epochs=tuple(run.epochs for run in runs),
        epochs_planned=runs[0].epochs_planned,
        steps=tuple(run.steps for run in runs),
        minutes=tuple(run.minutes for run in runs),
    )


def _runs_notes(
    task: EvalTask, models: Sequence[TrainedModel], *, trivial: bool, published: bool
) -> list[str]:
    notes = ["± is the sample standard deviation over the seeds"]
    providers = sorted({model.predictor.pipeline.session.provider for model in models})
    notes.append(
        f"ms: median of the network alone for one picture, onnxruntime on {', '.join(providers)}, "
        "measured in turns in this run"
    )
    short = [m.run.name for m in models if m.run.epochs < m.run.epochs_planned]
    if short:
        notes.append(f"stopped before their schedule's end: {', '.join(short)}")
    if published and task.split.name != SplitName.PAPER:
        notes.append(
            f"the paper's rows are of its own {PUBLISHED_COUNT} test pictures, not of these: "
            "their numbers are not comparable"
        )
    return [*notes, *(trivial_notes(task.split) if trivial else ())]
