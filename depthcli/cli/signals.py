"""The signals that ask a process to end."""

from __future__ import annotations

import signal
from typing import NoReturn

SIGNAL_BASE = 128
"""Shells report a signal as this plus its number."""
_NAMES = ("SIGTERM", "SIGHUP")  # Windows has no SIGHUP


def ending_signals() -> tuple[signal.Signals, ...]:
    """SIGTERM and SIGHUP, without those that whoever started us ignores, as nohup does."""
    known = (getattr(signal, name) for name in _NAMES if hasattr(signal, name))
    return tuple(number for number in known if signal.getsignal(number) is not signal.SIG_IGN)


def exit_on_signals() -> None:
    """Let these signals unwind the program, so that it removes its temporary files."""
    for number in ending_signals():
        signal.signal(number, _exit)


def _exit(number: int, _frame: object) -> NoReturn:
    for other in ending_signals():  # a second one would cut the cleaning up short
        signal.signal(other, signal.SIG_IGN)
    raise SystemExit(SIGNAL_BASE + number)
