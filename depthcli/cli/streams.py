"""Standard streams that are closed, on a full disk, or whose reader has exited.

A module of its own, free of other modules, because every command line begins with it.
"""

from __future__ import annotations

import io
import os
import sys

TYPE_CHECKING = False  # as in depthcli/__init__.py
if TYPE_CHECKING:
    from typing import Any

_SETTINGS = ("encoding", "errors", "line_buffering", "write_through")


class Stream(io.TextIOWrapper):
    """A standard stream that stores the first error (``problem``) instead of raising it.

    A broken pipe is raised if ``needs_reader`` is set, as for standard output.
    """

    problem: OSError | None = None
    needs_reader = False

    def write(self, text: str) -> int:
        """Write as much as possible."""
        try:
            return super().write(text)
        except OSError as error:
            self._store(error)
            return len(text)

    def flush(self) -> None:
        """Flush as much as possible."""
        try:
            super().flush()
        except OSError as error:
            self._store(error)

    def _store(self, error: OSError) -> None:
        if self.needs_reader and isinstance(error, BrokenPipeError):
            raise error
        self.problem = self.problem or error


def open_streams() -> Stream:
    """Make closed streams raise on reading and writing, and the others store errors.

    If a stream were left closed, the next file that is opened would get its number, and C libraries
    would write warnings into that file. Returns standard output.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            handle = os.open(os.devnull, os.O_RDONLY if number else os.O_WRONLY)
            if handle != number:
                os.dup2(handle, number)
                os.close(handle)
            os.set_inheritable(number, True)
            setattr(sys, name, os.fdopen(number, "w" if number else "r", closefd=False))
    sys.stderr = _wrap(sys.stderr)
    sys.stdout = stdout = _wrap(sys.stdout)
    stdout.needs_reader = True
    return stdout


def _wrap(original: Any) -> Stream:  # noqa: ANN401 - TextIO has no detach
    settings = {name: getattr(original, name) for name in _SETTINGS}
    return Stream(original.detach(), **settings)
