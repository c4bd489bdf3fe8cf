"""A run on a gray picture, which shows that a model does what its card says."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from depthcli.core.types import Frame
from depthcli.errors import ModelError
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import AUTO, Session

if TYPE_CHECKING:
    from depthcli.inference.catalog import Model

_GRAY = 128


def try_model(model: Model, *, provider: str = AUTO) -> Session:
    """Load a model and run it on a gray picture of its own size.

    Args:
        model: from the catalog.
        provider: as for :class:`Session`.

    Returns:
        The session, to ask it for its provider.

    Raises:
        ModelError: it does not load or run, or gives no finite depth.
    """
    session = Session(model, provider=provider)
    size = (model.card.input.height, model.card.input.width)
    depth = Pipeline(session).predict(Frame(np.full((*size, 3), _GRAY, np.uint8)))
    if not np.isfinite(depth.values).any():
        raise ModelError(f"{model.path} gives no depth for a gray picture; export the model again")
    return session
