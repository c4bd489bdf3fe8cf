"""The signals that ask a process to end, and how they end it at any moment.

An exception out of a signal handler could come anywhere: within an import, a library's callback or
what cleans up. So a signal removes temporary files and ends the process where it is, but for
commands that note it and finish what they are at.
"""

import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import NoReturn

from depthcli.core.ending import prepare_to_end
from depthcli.core.interrupt import Interrupt
from depthcli.io.storage.temporaries import remove_own

SIGNAL_BASE = 128
"""Shells report a signal as this plus its number."""
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows has no SIGHUP

_PATIENCE_S = 0.5
_finishing: list[tuple[float, Callable[[], object]]] = []
"""How long a block of :func:`finishing` may take, and what hurries it; the innermost last."""


def ending_signals() -> tuple[signal.Signals, ...]:
    """Those that whoever started us does not ignore, as nohup does."""
    known = (getattr(signal, name) for name in _NAMES if hasattr(signal, name))
    return tuple(number for number in known if signal.getsignal(number) is not signal.SIG_IGN)


def end_on_signals() -> None:
    """Let these signals end the process, also while its main thread is in a library's code."""
    read_end, write_end = os.pipe()
    if sys.platform != "win32":
        os.set_blocking(write_end, False)
    for number in ending_signals():
        signal.signal(number, _end)
    signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(read_end,), daemon=True).start()


@contextmanager
def finishing(patience_s: float, hurry: Callable[[], object]) -> Iterator[Interrupt]:
    """Note a signal within the block, which is to end then; a second one ends the process.

    Args:
        patience_s: how long the block may take to end.
        hurry: called from another thread when the signal comes.
    """
    with Interrupt(*ending_signals()) as interrupt:
        _finishing.append((patience_s, hurry))
        try:
            yield interrupt
        finally:
            _finishing.pop()


def _watch(read_end: int) -> None:
    """See to it that signals are obeyed where the main thread does not come to that."""
    while True:
        (number,) = os.read(read_end, 1)
        if signal.getsignal(number) is _end:
            patience_s = _PATIENCE_S
        elif _finishing:
            patience_s, hurry = _finishing[-1]
            hurry()
        else:
            continue
        select.select([read_end], (), (), patience_s)
        _leave_nothing()
        os._exit(SIGNAL_BASE + number)


def _end(number: int, _frame: object) -> NoReturn:
    _leave_nothing()
    with suppress(Exception):  # nobody listens, or it was interrupted in the middle of a line
        sys.stdout.flush()
    os._exit(SIGNAL_BASE + number)


def _leave_nothing() -> None:
    prepare_to_end()
    remove_own()
