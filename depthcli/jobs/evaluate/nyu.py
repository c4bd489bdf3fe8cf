"""Models, files of other tools and trivial rows, compared on NYU Depth v2."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.core.choices import Detail
from depthcli.core.progress import NO_PROGRESS
from depthcli.datasets.nyu import open_nyu
from depthcli.datasets.splits import SplitName
from depthcli.errors import UsageError
from depthcli.evaluation.nyu import HEADLINE_TABLE, evaluate_nyu, plan_nyu
from depthcli.evaluation.predictors.files import open_predictions
from depthcli.evaluation.predictors.model import open_models
from depthcli.evaluation.reports.figures import choose, draw_figures

if TYPE_CHECKING:
    from collections.abc import Callable

    from depthcli.core.progress import Progress
    from depthcli.core.types import DepthKind
    from depthcli.evaluation.nyu import EvalOptions
    from depthcli.evaluation.predictors.base import Predictor
    from depthcli.evaluation.report import EvalReport
    from depthcli.evaluation.reports.figures import Figure
    from depthcli.inference.loading import SessionLoader


@dataclass(frozen=True, slots=True)
class NyuRequest:
    """What is compared, on which pictures, and how."""

    data: Path  #: the labelled file, or a folder with it or with pictures and an index
    models: tuple[SessionLoader, ...] = ()  #: a row each
    predictions: tuple[Path, ...] = ()  #: folders with depth files of other tools, a row each
    predictions_kind: DepthKind | None = None  #: what those files mean; None to believe them
    split: SplitName = SplitName.PAPER  #: which division of the pairs
    limit: int | None = None  #: at most so many pictures, evenly over the split; None for all
    options: EvalOptions = HEADLINE_TABLE  #: how the table is made
    #: pictures to draw; empty for some of every type of scene, None for no figures
    shown_ids: tuple[str, ...] | None = None


@dataclass(frozen=True, slots=True)
class NyuResult:
    """The table, and sheets of sample pictures if there is a model or file to show."""

    report: EvalReport
    figures: tuple[Figure, ...]


def compare_on_nyu(
    request: NyuRequest,
    progress: Progress = NO_PROGRESS,
    warn: Callable[[str], object] = lambda _text: None,
) -> NyuResult:
    """Make the table; ``warn`` is told, in one line, where a model does not run as it should.

    Raises:
        UsageError: there is nothing to compare, an id to show is not compared, or no alignment
            suits a predictor.
        DatasetError: the data set or a prediction is not there, or cannot be read.
        ModelError: a model is not there or cannot be used.
    """
    task = plan_nyu(open_nyu(request.data), request.split, request.limit)
    positions = () if request.shown_ids is None else choose(task, request.shown_ids)
    if not (
        request.models or request.predictions or (request.options.trivial and task.split.train)
    ):
        raise UsageError(
            "nothing to compare: give --model or --predictions, or remove --no-model or "
            "--no-trivial (baselines need training pairs of the split)"
        )
    protocol = request.options.protocol
    detail = Detail(protocol.upsampling, protocol.tile_px)
    predictors: list[Predictor] = [
        *open_models(request.models, detail, warn),
        *(open_predictions(f, task.ids, request.predictions_kind) for f in request.predictions),
    ]
    report = evaluate_nyu(task, predictors, request.options, progress)
    if not (positions and predictors):
        return NyuResult(report, ())
    titles = [Path(predictor.name).name for predictor in predictors]
    return NyuResult(report, draw_figures(task, positions, predictors, titles, progress=progress))
