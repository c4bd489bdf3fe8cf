"""Evaluating models, files of other tools and training runs on a data set; files of the report."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Self

from depthcli.core.options import MILLIMETRES, DepthFit, UpsamplingOptions
from depthcli.core.parallel import NO_PROGRESS, Progress
from depthcli.errors import DepthcliError, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.storage.atomic import atomic_path, is_special, temporary_folder, write_text
from depthcli.io.stored.depth import AS_STATED, DepthReadOptions
from depthcli.lab.datasets.base import NYU
from depthcli.lab.datasets.nyu import is_nyu, open_nyu
from depthcli.lab.datasets.prompts import Prompt
from depthcli.lab.datasets.training_data import open_pairs
from depthcli.lab.evaluation import evaluate as table, predictors as sources
from depthcli.lab.evaluation.figures import Figure, choose_images, draw_figures
from depthcli.lab.evaluation.page import Page, html_page
from depthcli.lab.evaluation.report import EvalReport
from depthcli.lab.evaluation.task import EvalTask, group_by_seed, plan_nyu, plan_pairs, plan_runs
from depthcli.lab.jobs.bench import measure_latencies, network_run
from depthcli.lab.metrics.depth import MAX_DEPTH_M
from depthcli.lab.options import Mask, SplitName, Weights
from depthcli.lab.training.provenance import TrainedRun, data_set

_OWN_CSV, _OWN_HTML = b"name,source,align,", b"<footer>depthcli "
_SECONDS_A_NETWORK = 0.9


@dataclass(frozen=True, slots=True)
class EvalRequest:
    """Options of an evaluation: predictors, images and table."""

    data: Path  #: NYU Depth v2, as a file or a folder; or a folder of other pairs
    models: tuple[SessionLoader, ...] = ()  #: one row each
    predictions: tuple[Path, ...] = ()  #: folders with depth files of other tools, one row each
    predictions_reading: DepthReadOptions = AS_STATED  #: what is known about those files
    runs: Path | None = None  #: a training run or the folder of several; its seeds are one row
    weights: Weights = Weights.AVERAGED  #: of the runs: moving average, if there is one, or last
    runner: SessionLoader = field(default_factory=SessionLoader)  #: of runs, with another model
    prompt: Prompt | None = None  #: known depth that the models are given; None for none
    anchors_fit: DepthFit | None = None  #: to that; None for the best that each model can
    truth: DepthReadOptions = AS_STATED  #: what is known about the depth of a custom folder
    patterns: tuple[str, str] | None = None  #: names of images and depth, with ``*``
    split: SplitName | None = SplitName.PAPER  #: of NYU Depth v2; None for all pairs of a data set
    limit: int | None = None  #: maximum number of images, evenly over the split; None for all
    options: table.EvalOptions = table.HEADLINE_TABLE  #: options of the table
    shown_ids: tuple[str, ...] | None = None  #: of the figures; empty for some of each scene type


@dataclass(frozen=True, slots=True)
class EvalResult:
    """The table, the figures, if requested, and the runs that were left out."""

    report: EvalReport
    figures: tuple[Figure, ...] = ()
    failed: tuple[str, ...] = ()  #: name and reason of each run that cannot be used


def run_evaluation(
    request: EvalRequest,
    progress: Progress = NO_PROGRESS,
    warn: Callable[[str], object] = lambda _text: None,
) -> EvalResult:
    """Make the table; ``warn`` is called with warnings about models and predictions."""
    failed = list[str]()
    runs = _open_runs(request.runs, failed) if request.runs else []
    if request.split is SplitName.VAL and any(data_set(run.provenance.data) != NYU for run in runs):
        request = _on_own_pairs(request, runs)
    task = _plan_task(request, runs)
    options, protocol = request.options, request.options.protocol
    detail = UpsamplingOptions(protocol.upsampling, protocol.tile_px)
    positions = () if request.shown_ids is None else choose_images(task, request.shown_ids)
    trivial = sources.TRIVIAL_NAMES if options.trivial and task.split.train else ()
    if not (request.models or request.predictions or runs or trivial):
        advice = "give {model} or {predictions}, or the training pairs of the split for baselines"
        raise UsageError("nothing to compare", advice)
    if runs and options.against is not None:  # before the export
        table.check_against(options.against, [*trivial, *group_by_seed(runs)], protocol)
    if protocol.mask is Mask.RAW:
        task.dataset.raw_depth_m(task.test[0])  # before the models are loaded
    with temporary_folder() as folder:
        prompt, reading = (request.prompt, request.anchors_fit), request.predictions_reading
        models = [sources.open_model(loader, detail, *prompt) for loader in request.models]
        if runs:
            models += _load_runs(request, runs, detail, folder, progress, failed)
        images = [sources.Sample(task.dataset, i) for i in task.test]
        files = [sources.open_predictions(path, images, reading) for path in request.predictions]
        warnings = [] if runs else [task.dataset.warnings]  # of which training told
        warnings += [model.pipeline.session.warnings for model in models]
        warnings += [file.warnings for file in files]
        for text in dict.fromkeys(text for texts in warnings for text in texts):
            warn(text)
        compared: list[sources.Predictor] = [*models, *files]
        report = table.evaluate(task, compared, options, progress)
        raw = "weights of the last step, not their moving average"
        drawn = f"the models are given known depth of these images, {request.prompt}"
        notes = [raw] * (request.weights is Weights.RAW) + [drawn] * bool(request.prompt)
        report = replace(report, notes=(*report.notes, *notes))
        columns, figures = _shown(compared, report), tuple[Figure, ...]()
        if positions and columns:
            figures = draw_figures(task, positions, columns, progress)
    return EvalResult(report, figures, tuple(failed))


def _on_own_pairs(request: EvalRequest, runs: Sequence[TrainedRun]) -> EvalRequest:
    """The request for runs of a folder of one's own, whose unit and range are the runs'."""
    unit = runs[0].config.data.units_per_metre
    max_m = max(MAX_DEPTH_M, *(run.config.output.max_m for run in runs))
    protocol = replace(request.options.protocol, full_size_px=None, max_m=max_m)
    options = replace(request.options, protocol=protocol, published=False)
    truth = DepthReadOptions(scale=None if unit == MILLIMETRES else unit)
    return replace(request, split=None, truth=truth, options=options)


def _plan_task(request: EvalRequest, runs: Sequence[TrainedRun]) -> EvalTask:
    limit, name = request.limit, request.data.resolve().name
    if request.split is not None:
        plan = partial(plan_runs, runs=runs) if runs else plan_nyu
        return plan(open_nyu(request.data), split=request.split, limit=limit)
    if not (runs or request.patterns) and is_nyu(request.data):
        message = f"{request.data} is NYU Depth v2"
        raise UsageError(message, "compare on it with 'depthcli eval nyu'")
    pairs = open_pairs(request.data, request.truth, request.patterns)
    return (
        plan_runs(pairs, runs, limit=limit, title=name) if runs else plan_pairs(pairs, name, limit)
    )


def _open_runs(folder: Path, failed: list[str]) -> list[TrainedRun]:
    """The runs that can be used; name and reason of the others are added to ``failed``."""
    from depthcli.lab.export.onnx import find_runs, open_run  # noqa: PLC0415 - needs torch

    opened = []
    for path in find_runs(folder):
        with _noted(path.name, failed):
            opened.append(open_run(path))
    if not opened:
        raise DepthcliError(f"no run of {folder} can be used: {'; '.join(failed)}")
    return opened


def _load_runs(
    request: EvalRequest,
    runs: Sequence[TrainedRun],
    detail: UpsamplingOptions,
    folder: Path,
    progress: Progress,
    failed: list[str],
) -> list[sources.ModelPredictor]:
    """The exported models; runs that cannot be exported are added to ``failed``."""
    from depthcli.lab.export.onnx import export_run  # noqa: PLC0415 - needs torch

    advance, models = progress.begin("exporting runs", len(runs)), list[sources.ModelPredictor]()
    for run in runs:
        with _noted(run.name, failed):
            path = export_run(run, folder, request.weights)
            model = sources.open_model(replace(request.runner, model=path), detail)
            models.append(replace(model, name=run.name, run=run))
        advance(1)
    if not models:
        raise DepthcliError(f"no run can be exported: {'; '.join(failed)}")
    networks = [network_run(model.pipeline) for model in models]
    times = measure_latencies(networks, _SECONDS_A_NETWORK)
    pairs = zip(models, times, strict=True)
    return [replace(model, latency_ms=time.median_ms) for model, time in pairs]


@contextmanager
def _noted(name: str, failed: list[str]) -> Iterator[None]:
    """Note an error of a run, so that the others are compared."""
    try:
        yield
    except DepthcliError as error:
        failed.append(f"{name} ({error})")


def _shown(
    predictors: Sequence[sources.Predictor], report: EvalReport
) -> list[tuple[str, sources.Predictor]]:
    """The predictors of the figures with their titles: of a training run, its first seed."""
    if not report.has_training:
        return [(Path(predictor.name).name, predictor) for predictor in predictors]
    by_name = {predictor.name: predictor for predictor in predictors}
    firsts = {row.name: row.seeds[0].name for row in report.rows if row.seeds}
    return [(title, by_name[name]) for title, name in firsts.items()]


@dataclass(frozen=True, slots=True)
class ReportFiles:
    """Paths of the files to write; None for those that are not."""

    csv: Path | None = None  #: the table
    figures: Path | None = None  #: folder for the figures
    html: Path | None = None  #: table and figures in one file

    def checked(self) -> Self:
        """These files; UsageError, before the evaluation, if one but a report would be replaced."""
        for path, mark in ((self.csv, _OWN_CSV), (self.html, _OWN_HTML)):
            if path is None:
                continue
            if is_special(path):
                raise UsageError(f"{path} is a folder, a device or a pipe", "name a file")
            if path.is_file() and mark not in path.read_bytes():
                raise UsageError(f"{path} is no report of depthcli and is not replaced")
        return self

    def write(self, page: Page, table_csv: str, figures: Sequence[Figure]) -> Iterator[Path]:
        """Write the files, and yield the path of each figure once it is written."""
        if self.csv is not None:
            write_text(table_csv, self.csv)
        for figure in figures if self.figures else ():
            path = (self.figures or Path()) / f"{figure.name}.png"
            with atomic_path(path) as temporary:
                temporary.write_bytes(figure.png)
            yield path
        if self.html is not None:
            write_text(html_page(page, figures), self.html)
