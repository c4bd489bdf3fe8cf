"""Handling of SIGINT, SIGTERM and SIGHUP.

An exception from a signal handler could be raised anywhere: within an import, a library's callback
or clean-up code. So a signal removes temporary files and ends the process at once, except in
commands that shut down gracefully.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import NoReturn

from depthcli.core.parallel import Interrupt, run_exit_hooks
from depthcli.errors import SIGNAL_BASE
from depthcli.io.storage.atomic import remove_own

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP

_GRACE_PERIOD_S = 0.5
_shutdowns: list[tuple[float, Callable[[], object]]] = []
"""Grace period and callback of each :func:`graceful_shutdown` block; the innermost last."""


def ending_signals() -> tuple[signal.Signals, ...]:
    """The signals that end this process; not those that are ignored, as under nohup."""
    numbers = (getattr(signal, name) for name in _NAMES if hasattr(signal, name))
    return tuple(number for number in numbers if signal.getsignal(number) is not signal.SIG_IGN)


def end_on_signals() -> None:
    """Make these signals end the process, also while its main thread runs native code."""
    read_end, write_end = os.pipe()
    if sys.platform != "win32":
        os.set_blocking(write_end, False)
    for number in ending_signals():
        signal.signal(number, _end)
    signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(read_end,), daemon=True).start()


@contextmanager
def graceful_shutdown(
    grace_period_s: float, on_signal: Callable[[], object]
) -> Iterator[Interrupt]:
    """Record a signal within the block, which has to end then; a second one ends the process.

    The signal calls ``on_signal`` in another thread.
    """
    with Interrupt(*ending_signals()) as interrupt:
        _shutdowns.append((grace_period_s, on_signal))
        try:
            yield interrupt
        finally:
            _shutdowns.pop()


def _watch(read_end: int) -> None:
    """End the process on a signal if the main thread does not do so in time."""
    while True:
        (number,) = os.read(read_end, 1)
        if signal.getsignal(number) is _end:
            grace_period_s = _GRACE_PERIOD_S
        elif _shutdowns:
            grace_period_s, on_signal = _shutdowns[-1]
            on_signal()
        else:
            continue
        select.select([read_end], (), (), grace_period_s)
        _clean_up()
        os._exit(SIGNAL_BASE + number)


def _end(number: int, _frame: object) -> NoReturn:
    _clean_up()
    with suppress(Exception):  # the stream is closed, or was interrupted while writing
        sys.stdout.flush()
    os._exit(SIGNAL_BASE + number)


def _clean_up() -> None:
    run_exit_hooks()
    remove_own()
