"""An input that failed."""

from typing import NamedTuple

from depthcli.errors import DepthcliError


class Failed(NamedTuple):
    """An input that could not be used, or whose outputs could not be written."""

    name: str  #: the input, as the user wrote it
    error: DepthcliError  #: why
