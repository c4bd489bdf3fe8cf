"""Models as rows of the table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from depthcli.core.choices import PLAIN
from depthcli.evaluation.choices import Source
from depthcli.inference.pipeline import Pipeline

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from depthcli.core.choices import Detail
    from depthcli.core.types import DepthKind, DepthMap
    from depthcli.evaluation.predictors.base import Sample
    from depthcli.inference.loading import SessionLoader
    from depthcli.models.card import ModelCard


@dataclass(frozen=True, slots=True)
class ModelPredictor:
    """A model, run exactly as ``depthcli predict`` runs it.

    Attributes:
        name: as it was asked for: a name or a path.
        kind: what it predicts.
        model_sha256: checksum of its file.
        pipeline: what runs it.
        warnings: one-line texts, if it does not run where it should.
        source: always model.
    """

    name: str
    kind: DepthKind
    model_sha256: str
    pipeline: Pipeline
    warnings: tuple[str, ...] = ()
    source: Source = Source.MODEL

    @property
    def card(self) -> ModelCard:
        """The model's card."""
        return self.pipeline.card

    def predict(self, sample: Sample) -> DepthMap:
        """Depth at the picture's size.

        Raises:
            DepthcliError: the model failed.
        """
        return self.pipeline.predict(sample.frame)


def open_model(loader: SessionLoader, detail: Detail = PLAIN) -> ModelPredictor:
    """Find a model and load it.

    Raises:
        ModelError: it is not there or cannot be used.
    """
    pipeline = Pipeline(loader.load(), detail)
    return ModelPredictor(
        name=str(loader.model or pipeline.card.name),
        kind=pipeline.card.output.kind,
        model_sha256=pipeline.session.model.sha256,
        pipeline=pipeline,
        warnings=pipeline.session.warnings,
    )


def open_models(
    loaders: Sequence[SessionLoader], detail: Detail, warn: Callable[[str], object]
) -> list[ModelPredictor]:
    """Load models, and say once each what is not as it should be.

    Raises:
        DepthcliError: a model or its provider is not there or cannot be used.
    """
    models = [open_model(loader, detail) for loader in loaders]
    for warning in dict.fromkeys(text for model in models for text in model.warnings):
        warn(warning)
    return models
