"""Verifying that models match their cards and run."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from depthcli.errors import DepthcliError
from depthcli.inference.session import Session
from depthcli.inference.trial import try_other_size, try_session
from depthcli.models.catalog import Model, find_model
from depthcli.models.locations import list_locations


@dataclass(frozen=True, slots=True)
class ModelCheck:
    """The result of verifying one model."""

    name: str  #: as requested
    found: Model | DepthcliError  #: the model, or what is wrong with it


def verify_models(names: Sequence[str] = ()) -> Iterator[ModelCheck]:
    """Check size, checksum and card of each model, and run it on gray pictures.

    Args:
        names: names or paths; all models that have a name, if empty.
    """
    for name in names or [name for name, _ in list_locations()]:
        try:
            model = find_model(name)
            session = Session(model)
            try_session(session)
            try_other_size(session)
        except DepthcliError as error:
            yield ModelCheck(name, error)
        else:
            yield ModelCheck(name, model)
