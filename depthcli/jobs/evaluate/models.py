"""Comparing models, predictions of other tools and trivial baselines on a data set."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from depthcli.core.choices import Detail
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.core.types import DepthKind
from depthcli.datasets.base import DepthDataset, HasRawDepth
from depthcli.datasets.layouts import opener_of
from depthcli.datasets.nyu import has_own_index, open_indexed_folder, open_nyu
from depthcli.datasets.paired_folder import open_paired_folder
from depthcli.datasets.splits import SplitName
from depthcli.errors import UsageError
from depthcli.evaluation.against import check_against
from depthcli.evaluation.choices import Mask
from depthcli.evaluation.models_table import evaluate_models
from depthcli.evaluation.predictors.base import Predictor
from depthcli.evaluation.predictors.files import open_predictions
from depthcli.evaluation.predictors.model import open_models
from depthcli.evaluation.report import EvalReport
from depthcli.evaluation.reports.figures import Figure, choose_pictures, draw_figures
from depthcli.evaluation.table import (
    HEADLINE_TABLE,
    EvalOptions,
    EvalTask,
    plan_nyu,
    plan_pairs,
)
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import MILLIMETRES


@dataclass(frozen=True, slots=True)
class ModelsRequest:
    """What is compared, on which pictures, and how."""

    data: Path  #: NYU Depth v2, as a file or a folder; or a folder of other pairs
    models: tuple[SessionLoader, ...] = ()  #: one row each
    predictions: tuple[Path, ...] = ()  #: folders with depth files of other tools, one row each
    predictions_kind: DepthKind | None = None  #: depth kind of those files; None if they state it
    #: units per metre of those files, if they hold integers and do not state it; None for
    #: millimetres
    predictions_scale: float | None = None
    #: units per metre of the depth images of a custom folder; None for millimetres
    units_per_metre: float | None = None
    #: split of NYU Depth v2; None for all pairs of a custom data set
    split: SplitName | None = SplitName.PAPER
    limit: int | None = None  #: maximum number of pictures, evenly over the split; None for all
    options: EvalOptions = HEADLINE_TABLE  #: options of the table
    against: str | None = None  #: also compare this row with every other
    #: ids of pictures for the figures; empty for some of each scene type, None for no figures
    shown_ids: tuple[str, ...] | None = None


@dataclass(frozen=True, slots=True)
class ModelsResult:
    """The table, and the figures, if requested."""

    report: EvalReport
    figures: tuple[Figure, ...]


def compare_models(
    request: ModelsRequest,
    progress: Progress = NO_PROGRESS,
    warn: Callable[[str], object] = lambda _text: None,
) -> ModelsResult:
    """Make the table; ``warn`` is called with warnings about models and predictions.

    Raises:
        UsageError: there is nothing to compare, a requested row or picture is not compared, or no
            alignment suits a predictor.
        DatasetError: the data set or a prediction is missing or cannot be read.
        ModelError: a model is missing or cannot be used.
    """
    task = _plan_task(request)
    positions = () if request.shown_ids is None else choose_pictures(task, request.shown_ids)
    if not (request.models or request.predictions or task.has_trivial(request.options)):
        raise UsageError(
            "nothing to compare: give --model or --predictions, or remove --no-model or "
            "--no-trivial (baselines need training pairs of the split)"
        )
    if request.options.protocol.mask is Mask.RAW and isinstance(task.dataset, HasRawDepth):
        for position in task.test[:1]:  # raises early for a data set without raw depth
            task.dataset.raw_depth_m(position)
    predictors = _open_predictors(request, task, warn)
    if request.against is not None:
        check_against(request.against, task, predictors, request.options)
    report = evaluate_models(task, predictors, request.options, progress, against=request.against)
    if not (positions and predictors):
        return ModelsResult(report, ())
    titles = [Path(predictor.name).name for predictor in predictors]
    figures = draw_figures(task, positions, predictors, titles, progress=progress)
    return ModelsResult(report, figures)


def _plan_task(request: ModelsRequest) -> EvalTask:
    if request.split is not None:
        return plan_nyu(open_nyu(request.data), request.split, request.limit)
    dataset = _open_pairs(request.data, request.units_per_metre)
    return plan_pairs(dataset, request.data.resolve().name, request.limit)


def _open_pairs(path: Path, units_per_metre: float | None) -> DepthDataset:
    opener, units = opener_of(path), units_per_metre or MILLIMETRES
    if opener is None:
        return open_paired_folder(path, units_per_metre=units)
    if opener is not open_nyu:
        if units_per_metre is not None:
            raise UsageError(f"{path} is in a unit that is known: remove --png-scale")
        return opener(path)
    if not has_own_index(path):
        raise UsageError(f"{path} is NYU Depth v2: compare on it with 'depthcli eval nyu'")
    return open_indexed_folder(path, units_per_metre=units)


def _open_predictors(
    request: ModelsRequest, task: EvalTask, warn: Callable[[str], object]
) -> list[Predictor]:
    protocol = request.options.protocol
    detail = Detail(protocol.upsampling, protocol.tile_px)
    kind, scale = request.predictions_kind, request.predictions_scale
    if scale is not None and not request.predictions:
        raise UsageError("--predictions-scale needs --predictions DIR")
    if kind is not None and not request.predictions:
        raise UsageError("--predictions-kind needs --predictions DIR")
    truth_scale = request.units_per_metre
    files = [
        open_predictions(folder, task.ids, kind, scale, truth_scale)
        for folder in request.predictions
    ]
    for warning in (text for predictor in files for text in predictor.warnings):
        warn(warning)
    return [*open_models(request.models, detail, warn), *files]
