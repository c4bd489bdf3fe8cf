"""How far long work has come, told to whoever wants to know."""

from collections.abc import Callable
from typing import Protocol


class Progress(Protocol):
    """Somebody who watches work that has one stage or several."""

    def begin(self, what: str, total: int | None, unit: str = "") -> Callable[[int], None]:
        """Announce a stage; what is returned is told of each number of units more that are done.

        The name is empty where it is all that there is, ``total`` is None if it is not known, and
        the unit is in the plural: ``frames``.
        """


class _NoProgress:
    """Nobody watches."""

    def begin(self, what: str, total: int | None, unit: str = "") -> Callable[[int], None]:
        """Nothing."""
        del what, total, unit
        return lambda _count: None


NO_PROGRESS: Progress = _NoProgress()
