"""A trial run on a gray picture, which checks a model against its card."""

import numpy as np

from depthcli.core.types import Frame
from depthcli.errors import ModelError
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import Session

_GRAY = 128


def try_session(session: Session) -> None:
    """Run a loaded model on a gray picture of its own size.

    Raises:
        ModelError: it does not run, or has no finite output.
    """
    spec = session.model.card.input
    _predict_gray(session, spec.height, spec.width)


def try_other_size(session: Session) -> None:
    """Run a model on a wider picture, if its card states that its input may have any size.

    Graphs of dynamic axes may still hold constants that suit one size, such as embeddings.

    Raises:
        ModelError: it does not run.
    """
    model = session.model
    spec = model.card.input
    if not spec.dynamic:
        return
    try:
        _predict_gray(session, spec.height, spec.width * 3 // 2)
    except ModelError as error:
        raise ModelError(
            f"{model.path} runs only on inputs of {spec.width} x {spec.height}, although its axes "
            "are dynamic; set input.dynamic to false and input.fit to stretch in the card"
        ) from error


def check_network(error: Exception, session: Session) -> None:
    """Check the network after it failed on an input; it may work for the next one.

    Raises:
        ModelError: the same, if the network also fails on a plain gray picture.
    """
    if isinstance(error, ModelError):
        try:
            try_session(session)
        except ModelError:
            raise error from None


def _predict_gray(session: Session, height: int, width: int) -> None:
    Pipeline(session).predict(Frame(np.full((height, width, 3), _GRAY, np.uint8)))
