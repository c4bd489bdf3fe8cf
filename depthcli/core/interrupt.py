"""Deferring a signal until work can stop."""

import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Self

Handler = Callable[[int, FrameType | None], object] | int | None


class Interrupt:
    """Records the first signal while it is entered; a second one has its usual effect.

    ``number`` is the signal that was received, or None; always None outside the main thread.
    """

    def __init__(self, *signals: signal.Signals) -> None:
        self.number: int | None = None
        self._signals = signals
        self._handlers: dict[signal.Signals, Handler] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in self._signals:
                self._handlers[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        self._handlers = {}

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        if self.number is None:
            self.number = number
            return
        self.__exit__()
        signal.raise_signal(signal.Signals(number))
