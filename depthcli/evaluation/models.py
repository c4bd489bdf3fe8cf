"""Models as rows of the table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from depthcli.core.types import DepthKind
from depthcli.evaluation.choices import Source
from depthcli.inference.catalog import find_model
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import Session

if TYPE_CHECKING:
    from depthcli.core.types import DepthMap
    from depthcli.evaluation.predictors import Sample


@dataclass(frozen=True, slots=True)
class ModelPredictor:
    """A model, run exactly as ``depthcli predict`` runs it.

    Attributes:
        name: name in its card.
        kind: what it predicts.
        model_sha256: checksum of its file.
        pipeline: what runs it.
        source: always model.
    """

    name: str
    kind: DepthKind
    model_sha256: str
    pipeline: Pipeline
    source: Source = Source.MODEL

    def predict(self, sample: Sample) -> DepthMap:
        """Depth at the picture's size.

        Raises:
            DepthcliError: the model failed.
        """
        return self.pipeline.predict(sample.frame)


def open_model(
    name_or_path: str | None, *, provider: str = "auto", threads: int | None = None
) -> ModelPredictor:
    """Find a model by name or path and load it.

    Raises:
        ModelError: it is not there or cannot be used.
    """
    model = find_model(name_or_path)
    session = Session(model, provider=provider, threads=threads)
    kind = DepthKind(model.card.output.kind)
    return ModelPredictor(model.card.name, kind, model.sha256, Pipeline(session))
