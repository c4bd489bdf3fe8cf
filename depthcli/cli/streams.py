"""Standard streams that are closed, on a full disk, or that nobody reads any more."""

from __future__ import annotations

import io
import os
import sys

TYPE_CHECKING = False  # as in depthcli/__init__.py
if TYPE_CHECKING:
    from typing import Any

_KEPT = ("encoding", "errors", "line_buffering", "write_through")


class Stream(io.TextIOWrapper):
    """A standard stream whose trouble does not stop the work; it is remembered instead.

    A reader of standard output that left does stop it, as it does other filters.
    """

    problem: OSError | None = None
    needs_reader = False

    def write(self, text: str) -> int:
        """Write as much as can be written."""
        try:
            return super().write(text)
        except OSError as error:
            self._remember(error)
            return len(text)

    def flush(self) -> None:
        """Pass on what was written, as far as that goes."""
        try:
            super().flush()
        except OSError as error:
            self._remember(error)

    def _remember(self, error: OSError) -> None:
        if self.needs_reader and isinstance(error, BrokenPipeError):
            raise error
        self.problem = self.problem or error


def open_streams() -> Stream:
    """Make closed streams refuse reading and writing, and let the others bear trouble.

    Where a stream is closed, the next file that is opened would become that stream, for C libraries
    too, which would write their warnings into it.

    Returns:
        Standard output.
    """
    for number, name, flags in (
        (0, "stdin", os.O_WRONLY),
        (1, "stdout", os.O_RDONLY),
        (2, "stderr", os.O_RDONLY),
    ):
        if getattr(sys, name) is None:
            _refuse(number, flags)
            setattr(sys, name, os.fdopen(number, "w" if number else "r", closefd=False))
    sys.stderr = _bearing(sys.stderr)
    sys.stdout = stdout = _bearing(sys.stdout)
    stdout.needs_reader = True
    return stdout


def _bearing(usual: Any) -> Stream:  # noqa: ANN401 - a TextIO does not say that it can be detached
    how = {what: getattr(usual, what) for what in _KEPT}
    return Stream(usual.detach(), **how)


def _refuse(number: int, flags: int) -> None:
    handle = os.open(os.devnull, flags)
    if handle != number:
        os.dup2(handle, number)
        os.close(handle)
    os.set_inheritable(number, True)
