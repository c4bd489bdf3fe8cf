"""The models of a comparison, and the predictions of other tools."""

from __future__ import annotations

from typing import TYPE_CHECKING

from depthcli.cli.screen import console
from depthcli.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from depthcli.core.choices import Detail
    from depthcli.evaluation.nyu import EvalTask
    from depthcli.evaluation.predictors.base import Predictor
    from depthcli.evaluation.predictors.model import ModelPredictor
    from depthcli.inference.loading import SessionLoader


def open_models(loaders: Sequence[SessionLoader], detail: Detail) -> list[ModelPredictor]:
    """Load models, and say once each what is not as it should be.

    Raises:
        DepthcliError: a model or its provider is not there or cannot be used.
    """
    if not loaders:
        return []
    from depthcli.evaluation.predictors.model import open_model

    models = [open_model(loader, detail) for loader in loaders]
    for warning in dict.fromkeys(text for model in models for text in model.warnings):
        console.warn(warning)
    return models


def open_prediction_folders(
    folders: Sequence[Path], task: EvalTask, kind_name: str | None
) -> list[Predictor]:
    """Find what other tools predicted for the pictures of a task.

    Raises:
        UsageError: no kind of depth has this name.
        DatasetError: a folder has not one file for each picture.
    """
    if not folders:
        return []
    from depthcli.core.types import DepthKind
    from depthcli.evaluation.predictors.files import open_predictions

    if kind_name not in {None, *DepthKind}:
        raise UsageError(f"--predictions-kind is {', '.join(DepthKind)}, not {kind_name}")
    kind = None if kind_name is None else DepthKind(kind_name)
    return [open_predictions(folder, task.ids, kind) for folder in folders]
