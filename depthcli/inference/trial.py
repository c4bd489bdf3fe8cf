"""A trial run on a gray picture, which checks a model against its card."""

import numpy as np

from depthcli.core.types import Frame
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import Session

_GRAY = 128


def try_session(session: Session) -> None:
    """Run a loaded model on a gray picture of its own size.

    Raises:
        ModelError: it does not run, or has no finite output.
    """
    card = session.model.card
    frame = Frame(np.full((card.input.height, card.input.width, 3), _GRAY, np.uint8))
    Pipeline(session).predict(frame)
