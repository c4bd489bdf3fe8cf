"""An input that failed."""

from typing import NamedTuple

from depthcli.errors import DepthcliError


class FailedInput(NamedTuple):
    """An input that cannot be used, or whose outputs cannot be written."""

    name: str  #: the input, as the user wrote it
    error: DepthcliError  #: why
