"""Names of parameters in place of the command line's options, in messages of the Python API."""

from collections.abc import Iterator
from contextlib import contextmanager

from depthcli.errors import DepthcliError

# Longer options first.
_PARAMETERS = {
    "--tile ": "tile_px=",
    "--tile": "tile_px",
    "--white-level ": "white_level=",
    "--provider-option": "provider_options",
    "--provider": "provider",
}


def with_parameter_names(text: str) -> str:
    """A message with the names of parameters."""
    for option, parameter in _PARAMETERS.items():
        text = text.replace(option, parameter)
    return text


@contextmanager
def parameter_names() -> Iterator[None]:
    """Let the errors of a block name parameters."""
    try:
        yield
    except DepthcliError as error:
        error.args = (with_parameter_names(str(error)), *error.args[1:])
        raise
