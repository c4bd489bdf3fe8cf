"""Models as rows of the table."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from depthcli.core.choices import PLAIN, Detail
from depthcli.core.types import DepthKind, DepthMap
from depthcli.evaluation.choices import Source
from depthcli.evaluation.predictors.base import Sample
from depthcli.inference.camera import metric_camera
from depthcli.inference.loading import SessionLoader
from depthcli.inference.pipeline import Pipeline
from depthcli.models.card import ModelCard


@dataclass(frozen=True, slots=True)
class ModelPredictor:
    """A model, run exactly as ``depthcli predict`` runs it."""

    name: str  #: as it was asked for: a name or a path
    kind: DepthKind  #: what it predicts
    model_sha256: str  #: checksum of its file
    pipeline: Pipeline  #: what runs it
    warnings: tuple[str, ...] = ()  #: one-line texts, if it does not run where it should
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
        if metric_camera(self.card) is None:
            return self.pipeline.predict(sample.frame)
        hfov_deg = None if sample.focal_px else sample.hfov_deg
        return self.pipeline.predict(sample.frame, focal_px=sample.focal_px, hfov_deg=hfov_deg)


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
