"""Models as rows of the table."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from depthcli.core.choices import DEFAULT_DETAIL, Detail
from depthcli.core.types import DepthKind, DepthMap
from depthcli.evaluation.choices import Source
from depthcli.evaluation.predictors.base import Sample
from depthcli.inference.loading import SessionLoader
from depthcli.inference.pipeline import Pipeline
from depthcli.models.card import ModelCard


@dataclass(frozen=True, slots=True)
class ModelPredictor:
    """A model, run in the same way as by ``depthcli predict``."""

    name: str  #: as requested: a name or a path
    kind: DepthKind  #: kind of depth that it predicts
    model_sha256: str  #: checksum of its file
    pipeline: Pipeline  #: the inference pipeline
    warnings: tuple[str, ...] = ()  #: warnings of its session, one line each
    source: Source = Source.MODEL  #: always model

    @property
    def card(self) -> ModelCard:
        """The model's card."""
        return self.pipeline.card

    def predict(self, sample: Sample) -> DepthMap:
        """Depth at the picture's size.

        Raises:
            DepthcliError: the model failed.
        """
        hfov_deg = None if sample.focal_px else sample.hfov_deg
        return self.pipeline.predict(sample.frame, focal_px=sample.focal_px, hfov_deg=hfov_deg)


def open_model(loader: SessionLoader, detail: Detail = DEFAULT_DETAIL) -> ModelPredictor:
    """Find a model and load it.

    Raises:
        ModelError: it is missing or cannot be used.
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
    """Load models; ``warn`` is called once with each distinct warning.

    Raises:
        DepthcliError: a model or its provider is missing or cannot be used.
    """
    models = [open_model(loader, detail) for loader in loaders]
    for warning in dict.fromkeys(text for model in models for text in model.warnings):
        warn(warning)
    return models
