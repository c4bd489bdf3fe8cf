"""Exporting training runs and comparing them on pictures that none of them was trained on."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from depthcli.core.choices import Detail, Weights
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.datasets.nyu import open_nyu
from depthcli.datasets.splits import SplitName
from depthcli.errors import DepthcliError
from depthcli.evaluation.against import check_row
from depthcli.evaluation.predictors.model import open_models
from depthcli.evaluation.reports.figures import Figure, choose_pictures, draw_figures
from depthcli.evaluation.runs_report import RunsReport
from depthcli.evaluation.runs_table import evaluate_runs
from depthcli.evaluation.table import HEADLINE_TABLE, EvalOptions
from depthcli.evaluation.trained import TrainedModel, group_by_seed, plan_comparison
from depthcli.export.trained import export_run, find_runs, open_run
from depthcli.inference.latency import measure_ms
from depthcli.inference.loading import SessionLoader
from depthcli.io.storage.temporary_folder import temporary_folder
from depthcli.training.trained_run import TrainedRun


@dataclass(frozen=True, slots=True)
class RunsRequest:
    """Which runs are compared, on which pictures, and how."""

    folder: Path  #: the folder of the runs, or a run
    data: Path  #: NYU Depth v2, which they were trained on
    #: split of the pairs; ``val`` is the pairs that the runs held out
    split: SplitName = SplitName.VAL
    limit: int | None = None  #: maximum number of pictures, evenly over the split; None for all
    #: the moving average, if a run has one, or the weights of the last step
    weights: Weights = Weights.AVERAGED
    options: EvalOptions = HEADLINE_TABLE  #: options of the table
    published: bool = True  #: include the paper's rows
    against: str | None = None  #: also compare this row with every other
    #: provider and threads; its model is not used
    runner: SessionLoader = field(default_factory=SessionLoader)
    #: ids of pictures for the figures; empty for some of each scene type, None for no figures
    shown_ids: tuple[str, ...] | None = None


@dataclass(frozen=True, slots=True)
class RunsResult:
    """The result of a comparison of runs."""

    report: RunsReport  #: the table of all runs that could be used
    figures: tuple[Figure, ...]  #: figures of sample pictures, if requested
    failed: tuple[str, ...]  #: name and reason of each run that could not be used


def compare_runs(
    request: RunsRequest,
    progress: Progress = NO_PROGRESS,
    warn: Callable[[str], object] = lambda _text: None,
) -> RunsResult:
    """Export the runs and make the table; ``warn`` is called with the models' warnings.

    Raises:
        UsageError: the runs cannot be compared with each other or on these pictures, or a requested
            row or picture is not among them.
        DatasetError: the data set is missing or cannot be read.
        DepthcliError: no run can be used.
    """
    dataset = open_nyu(request.data)
    opened, failed = _open_runs(request.folder)
    task = plan_comparison(dataset, opened, request.split, request.limit)
    positions = () if request.shown_ids is None else choose_pictures(task, request.shown_ids)
    names = group_by_seed(
        opened
    )  # raises for runs that are not seeds of one row, before the export
    if request.against is not None:
        check_row(request.against, names)
    with temporary_folder() as fallback_folder:
        exported = _export_runs(opened, fallback_folder, request.weights, progress, failed)
        if request.against is not None:
            _check_exported(request.against, exported, failed)
        protocol = request.options.protocol
        detail = Detail(protocol.upsampling, protocol.tile_px)
        models = _load_models(exported, request.runner, detail, warn)
        report = evaluate_runs(
            task,
            models,
            request.options,
            progress,
            published=request.published,
            weights=request.weights,
            against=request.against,
        )
        if not positions:
            return RunsResult(report, (), tuple(failed))
        firsts = {row.row.name: row.runs[0].name for row in report.rows if row.runs}
        by_run = {model.run.name: model.predictor for model in models}
        shown = [by_run[name] for name in firsts.values()]
        figures = draw_figures(task, positions, shown, list(firsts), progress=progress)
    return RunsResult(report, figures, tuple(failed))


def _open_runs(folder: Path) -> tuple[list[TrainedRun], list[str]]:
    """The runs that can be used, and name and reason of the others."""
    opened, failed = [], []
    for run in find_runs(folder):
        try:
            opened.append(open_run(run))
        except DepthcliError as error:
            failed.append(f"{run.name} ({error})")
    if not opened:
        raise DepthcliError(f"no run of {folder} can be used: {'; '.join(failed)}")
    return opened, failed


def _export_runs(
    opened: Sequence[TrainedRun],
    fallback_folder: Path,
    weights: Weights,
    progress: Progress,
    failed: list[str],
) -> list[tuple[TrainedRun, Path]]:
    """Every run with its model; runs that cannot be exported are added to ``failed``."""
    advance, exported = progress.begin("exporting runs", len(opened)), []
    for run in opened:
        try:
            exported.append((run, export_run(run, fallback_folder, weights)))
        except DepthcliError as error:
            failed.append(f"{run.name} ({error})")
        advance(1)
    if not exported:
        raise DepthcliError(f"no run can be exported: {'; '.join(failed)}")
    return exported


def _check_exported(
    against: str, exported: Sequence[tuple[TrainedRun, Path]], failed: Sequence[str]
) -> None:
    if against not in group_by_seed([run for run, _ in exported]):
        raise DepthcliError(f"no run of {against} can be exported: {'; '.join(failed)}")


def _load_models(
    exported: Sequence[tuple[TrainedRun, Path]],
    runner: SessionLoader,
    detail: Detail,
    warn: Callable[[str], object],
) -> list[TrainedModel]:
    """Every run with its loaded model and its latency."""
    loaders = [replace(runner, model=path) for _, path in exported]
    opened = open_models(loaders, detail, warn)
    times_ms = measure_ms([model.pipeline for model in opened])
    rows = zip(exported, opened, times_ms, strict=True)
    return [TrainedModel(run, replace(model, name=run.name), ms) for (run, _), model, ms in rows]
