"""Progress reports of long-running work."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Protocol, Self


class Progress(Protocol):
    """Receives the progress of work that has one or more stages."""

    def begin(self, what: str, total: int | None, unit: str = "") -> Callable[[float], None]:
        """Begin a stage, which may have no name if it is the only one, of a number of units.

        What is returned is called with the number of units done since the last call.
        """


class _NoProgress:
    """Ignores progress."""

    def begin(self, what: str, total: int | None, unit: str = "") -> Callable[[float], None]:
        """Nothing."""
        del what, total, unit
        return lambda _count: None


NO_PROGRESS: Progress = _NoProgress()


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


@contextlib.contextmanager
def without_interrupts() -> Iterator[None]:
    """Block Ctrl-C for processes that the block starts, whose imports would end in tracebacks."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    from multiprocessing.resource_tracker import ensure_running  # noqa: PLC0415 - for batches

    ensure_running()  # to start it unblocks the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_actions: list[Callable[[], object]] = []


@contextlib.contextmanager
def exit_hook(action: Callable[[], object]) -> Iterator[None]:
    """Call a function, from any thread or signal handler, if the process exits in the block."""
    _actions.append(action)
    try:
        yield
    finally:
        _actions.remove(action)


def run_exit_hooks() -> None:
    """Call all hooks, the last one first; their exceptions are ignored."""
    for action in reversed(_actions):
        with contextlib.suppress(Exception):
            action()
