"""Whether models are what their cards say, and run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from depthcli.errors import DepthcliError
from depthcli.inference.trial import try_model
from depthcli.models.catalog import find_model
from depthcli.models.places import list_places

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from depthcli.models.catalog import Model


@dataclass(frozen=True, slots=True)
class ModelCheck:
    """What was found of one model.

    Attributes:
        name: as it was asked for.
        found: the model, or what is wrong with it.
    """

    name: str
    found: Model | DepthcliError


def verify_models(names: Sequence[str] = ()) -> Iterator[ModelCheck]:
    """Check size, checksum and card of each model, and run it once.

    Args:
        names: names or paths; all models that have a name, if empty.
    """
    for name in names or [name for name, _ in list_places()]:
        try:
            model = find_model(name)
            try_model(model)
        except DepthcliError as error:
            yield ModelCheck(name, error)
        else:
            yield ModelCheck(name, model)
