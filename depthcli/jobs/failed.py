"""An input that failed, and why."""

from typing import NamedTuple

from depthcli.errors import NO_THREADS, DepthcliError, is_out_of_memory, is_out_of_threads


class FailedInput(NamedTuple):
    """An input that cannot be used, or whose outputs cannot be written."""

    name: str  #: the input, as the user wrote it
    error: DepthcliError  #: why


def failure_reason(error: Exception) -> str:
    """The reason why an input failed, in one line."""
    if isinstance(error, DepthcliError):
        return error.message
    if is_out_of_memory(error):
        return "does not fit into memory; make it smaller"
    if is_out_of_threads(error):
        return NO_THREADS
    if isinstance(error, OSError) and error.strerror:  # for example too many open files
        return ": ".join(filter(None, (error.filename and str(error.filename), error.strerror)))
    return f"unexpected {type(error).__name__}: {error}"
