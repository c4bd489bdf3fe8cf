"""Ending work on a signal, at a place where it can be ended."""

import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Self

Handler = Callable[[int, FrameType | None], object] | int | None


class Interrupt:
    """Notes a signal while it is entered; a second one acts as it would have without us.

    ``number`` is the signal that came, or None; outside the main thread none is noted.
    """

    def __init__(self, *signals: signal.Signals) -> None:
        self.number: int | None = None
        self._signals = signals
        self._before: dict[signal.Signals, Handler] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in self._signals:
                self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        self._before = {}

    def _note(self, number: int, _frame: FrameType | None) -> None:
        if self.number is None:
            self.number = number
            return
        self.__exit__()
        signal.raise_signal(signal.Signals(number))
