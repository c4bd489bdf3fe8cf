"""How far long work has come, told to whoever wants to know."""

from collections.abc import Callable
from typing import Protocol


class Progress(Protocol):
    """Somebody who watches work that has one stage or several."""

    def begin(self, what: str, total: int | None, unit: str = "") -> Callable[[int], None]:
        """Announce a stage.

        Args:
            what: its name; empty where it is all that there is.
            total: units in all; None if that is not known.
            unit: what is counted, in the plural: ``frames``.

        Returns:
            What to call with how many units more are done.
        """


class _NoProgress:
    """Nobody watches."""

    def begin(self, what: str, total: int | None, unit: str = "") -> Callable[[int], None]:
        """Nothing."""
        del what, total, unit
        return lambda _count: None


NO_PROGRESS: Progress = _NoProgress()
