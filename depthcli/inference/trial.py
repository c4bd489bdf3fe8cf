"""A trial run on a gray picture, which checks a model against its card."""

import numpy as np

from depthcli.core.types import Frame
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.providers import AUTO
from depthcli.inference.session import Session
from depthcli.models.catalog import Model

_GRAY = 128


def try_model(model: Model, *, provider: str = AUTO) -> Session:
    """Load a model and run it on a gray picture of its own size; returns the session.

    Raises:
        ModelError: it does not load or run, or has no finite output.
    """
    session = Session(model, provider=provider)
    try_session(session)
    return session


def try_session(session: Session) -> None:
    """Run a loaded model on a gray picture of its own size.

    Raises:
        ModelError: it does not run, or has no finite output.
    """
    card = session.model.card
    frame = Frame(np.full((card.input.height, card.input.width, 3), _GRAY, np.uint8))
    Pipeline(session).predict(frame)
