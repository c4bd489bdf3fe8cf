"""The runs of a training, exported and compared on pictures that none of them has learned."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from depthcli.core.choices import Detail, Weights
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.datasets.nyu import open_nyu
from depthcli.datasets.splits import SplitName
from depthcli.errors import DepthcliError, UsageError
from depthcli.evaluation.predictors.model import open_models
from depthcli.evaluation.reports.figures import Figure, choose, draw_figures
from depthcli.evaluation.runs_report import RunsReport
from depthcli.evaluation.runs_table import evaluate_runs
from depthcli.evaluation.table import HEADLINE_TABLE, EvalOptions
from depthcli.evaluation.trained import TrainedModel, grouped, plan_comparison
from depthcli.export.trained import export_run, find_runs, open_run
from depthcli.inference.latency import measure_ms
from depthcli.inference.loading import SessionLoader
from depthcli.io.storage.temporary_folder import temporary_folder
from depthcli.training.trained_run import TrainedRun


@dataclass(frozen=True, slots=True)
class RunsRequest:
    """Which runs are compared, on which pictures, and how."""

    folder: Path  #: holds the runs, or is one
    data: Path  #: NYU Depth v2, which they were trained on
    #: which division of the pairs; ``val`` is what the runs themselves held out
    split: SplitName = SplitName.VAL
    limit: int | None = None  #: at most so many pictures, evenly over the split; None for all
    #: the moving average, where a run keeps one, or those of the last step
    weights: Weights = Weights.AVERAGED
    options: EvalOptions = HEADLINE_TABLE  #: how the table is made
    published: bool = True  #: include the paper's rows
    against: str | None = None  #: also compare this row with every other
    #: what runs the models; its own model is not used
    runner: SessionLoader = field(default_factory=SessionLoader)
    #: pictures to draw; empty for some of every type of scene, None for no figures
    shown_ids: tuple[str, ...] | None = None


@dataclass(frozen=True, slots=True)
class RunsResult:
    """The table."""

    report: RunsReport  #: of all runs that could be used
    figures: tuple[Figure, ...]  #: sheets of sample pictures, if they were asked for
    failed: tuple[str, ...]  #: name of each other run, and why


def compare_runs(
    request: RunsRequest,
    progress: Progress = NO_PROGRESS,
    warn: Callable[[str], object] = lambda _text: None,
) -> RunsResult:
    """Make the table; ``warn`` is told, in one line, where a model does not run as it should.

    Raises:
        UsageError: the runs cannot be compared with each other or on these pictures, or what is
            asked for is not among them.
        DatasetError: the data set is not there or cannot be read.
        DepthcliError: no run can be used.
    """
    dataset = open_nyu(request.data)
    opened, failed = _open_runs(request.folder)
    task = plan_comparison(dataset, opened, request.split, request.limit)
    positions = () if request.shown_ids is None else choose(task, request.shown_ids)
    names = grouped(opened)  # refuses what is no seed of a row before anything is exported
    if request.against is not None and request.against not in names:
        raise UsageError(
            f"--against {request.against} is not a row; choose from {', '.join(names)}"
        )
    with temporary_folder() as spare:
        exported = _exported(opened, spare, request.weights, progress, failed)
        protocol = request.options.protocol
        detail = Detail(protocol.upsampling, protocol.tile_px)
        models = _loaded(exported, request.runner, detail, warn)
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
    """The runs that can be used, and why others cannot."""
    opened, failed = [], []
    for run in find_runs(folder):
        try:
            opened.append(open_run(run))
        except DepthcliError as error:
            failed.append(f"{run.name} ({error})")
    if not opened:
        raise DepthcliError(f"no run of {folder} can be used: {'; '.join(failed)}")
    return opened, failed


def _exported(
    opened: Sequence[TrainedRun],
    spare: Path,
    weights: Weights,
    progress: Progress,
    failed: list[str],
) -> list[tuple[TrainedRun, Path]]:
    """Every run with its model; those that cannot be exported join ``failed``."""
    advance, exported = progress.begin("exporting runs", len(opened)), []
    for run in opened:
        try:
            exported.append((run, export_run(run, spare, weights)))
        except DepthcliError as error:
            failed.append(f"{run.name} ({error})")
        advance(1)
    if not exported:
        raise DepthcliError(f"no run can be exported: {'; '.join(failed)}")
    return exported


def _loaded(
    exported: Sequence[tuple[TrainedRun, Path]],
    runner: SessionLoader,
    detail: Detail,
    warn: Callable[[str], object],
) -> list[TrainedModel]:
    """Every run with its model, ready to predict, and the time that it takes."""
    loaders = [replace(runner, model=path) for _, path in exported]
    opened = open_models(loaders, detail, warn)
    times_ms = measure_ms([model.pipeline for model in opened])
    rows = zip(exported, opened, times_ms, strict=True)
    return [TrainedModel(run, replace(model, name=run.name), ms) for (run, _), model, ms in rows]
