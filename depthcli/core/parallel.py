"""Long-running work: threads in order and in bounded memory, progress, signals."""

from __future__ import annotations

import math
import os
import signal
import threading
from collections import deque
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any, Generic, Protocol, Self, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator
    from concurrent.futures import Future
    from types import FrameType

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def ordered_map(
    function: Callable[[_Item], _Result],
    items: Iterable[_Item],
    *,
    workers: int,
    ahead: int | None = None,
) -> Generator[_Result, None, None]:
    """``map`` by threads: results come in the order of the items, however long each takes.

    Items are pulled by the thread that iterates, so an iterator over a video need not be safe for
    threads, and at most ``ahead`` of them (None for two for each worker) before their results are
    asked for. 0 workers work in the calling thread. What the function raises is raised at that
    item's turn; items not yet begun are dropped then, as they are when the iterator is closed.
    """
    if workers == 0:
        yield from map(function, items)
        return
    from concurrent.futures import ThreadPoolExecutor  # noqa: PLC0415 - predict needs none

    ahead = 2 * workers if ahead is None else ahead
    pending: deque[Future[_Result]] = deque()
    pool = ThreadPoolExecutor(workers, thread_name_prefix="depthcli")
    try:
        for item in items:
            pending.append(pool.submit(function, item))
            if len(pending) >= ahead:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def start_worker() -> None:
    """Let a worker process ignore Ctrl-C, and end with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process ends its workers
    Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    """Exit when the parent was killed; else the worker would wait for work forever."""
    from multiprocessing import parent_process  # noqa: PLC0415 - only batches need it

    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


class Background(Generic[_Result]):
    """One function, started at once in its own thread.

    The standard library's executors do the same, but importing them takes longer than is saved.
    """

    def __init__(self, function: Callable[[], _Result]) -> None:
        self._function = function
        self._result: list[_Result] = []
        self._error: BaseException | None = None
        # A daemon, so that Ctrl-C need not wait for a model that loads for seconds.
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    def result(self) -> _Result:
        """Wait for the function; return what it returned, or raise what it raised."""
        self._thread.join()
        if self._error is not None:
            raise self._error
        return self._result[0]

    def _run(self) -> None:
        try:
            self._result.append(self._function())
        except BaseException as error:  # noqa: BLE001 - raised again by result()
            self._error = error


_CPU_MAX = Path("/sys/fs/cgroup/cpu.max")  #: of control groups, version 2


def usable_cores() -> int:
    """Cores that this process may use, which in a container can be fewer than the machine has."""
    cores: float = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    with suppress(OSError, ValueError):  # there is none, or "max" for no limit
        quota_us, period_us = _CPU_MAX.read_text("ascii").split()
        cores = min(cores, int(quota_us) / int(period_us))
    return max(1, math.ceil(cores))


def share_cores(workers: int | None = None, threads: int | None = None) -> tuple[int, int]:
    """Number of workers, by default one a core, and of threads for each, by default its share."""
    cores = usable_cores()
    workers = workers or cores
    return workers, threads or max(1, cores // workers)


@contextmanager
def one_thread_each(workers: int) -> Iterator[None]:
    """Let OpenCV use the calling thread alone while there are two workers or more."""
    import cv2  # noqa: PLC0415 - not for those that only need a thread

    threads = cv2.getNumThreads()
    if workers > 1:
        cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


class Progress(Protocol):
    """Receives the progress of work that has one or more stages."""

    def begin(self, what: str, total: int | None, unit: str = "") -> Callable[[float], None]:
        """Begin a stage, which may have no name if it is the only one, of a number of units.

        What is returned is called with the number of units done since the last call.
        """
        del what, total, unit
        return lambda _count: None


class _NoProgress(Progress):
    """Ignores progress."""


NO_PROGRESS: Progress = _NoProgress()


class Interrupt:
    """Records the first signal while it is entered; a second one has its usual effect.

    ``number`` is the signal that was received, or None; always None outside the main thread.
    """

    def __init__(self, *signals: signal.Signals) -> None:
        self.number: int | None = None
        self._signals = signals
        self._handlers: dict[signal.Signals, Any] = {}

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


@contextmanager
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


@contextmanager
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
        with suppress(Exception):
            action()
