"""Progress reports of long-running work."""

from collections.abc import Callable
from typing import Protocol


class Progress(Protocol):
    """Receives the progress of work that has one or more stages."""

    def begin(self, what: str, total: int | None, unit: str = "") -> Callable[[int], None]:
        """Begin a stage.

        Args:
            what: name of the stage; empty if it is the only one.
            total: number of units; None if it is not known.
            unit: in the plural, such as ``frames``.

        Returns:
            Called with the number of units done since the last call.
        """


class _NoProgress:
    """Ignores progress."""

    def begin(self, what: str, total: int | None, unit: str = "") -> Callable[[int], None]:
        """Nothing."""
        del what, total, unit
        return lambda _count: None


NO_PROGRESS: Progress = _NoProgress()
