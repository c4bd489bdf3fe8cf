"""An input that came to nothing."""

from dataclasses import dataclass

from depthcli.errors import DepthcliError


@dataclass(frozen=True, slots=True)
class Failed:
    """An input that could not be used, or whose outputs could not be written."""

    name: str  #: the input, as the user wrote it
    error: DepthcliError  #: why
