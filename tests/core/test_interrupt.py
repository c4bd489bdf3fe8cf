"""Signals that end a run: the first is noted, the second acts."""

import signal
import threading

import pytest

from depthcli.core.progress import Interrupt


def test_first_signal_is_noted_and_the_second_acts() -> None:
    before = signal.getsignal(signal.SIGINT)
    with Interrupt(signal.SIGINT) as interrupt:
        assert interrupt.number is None
        signal.raise_signal(signal.SIGINT)
        assert interrupt.number == signal.SIGINT
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is before
    assert signal.getsignal(signal.SIGINT) is before


def test_handlers_are_put_back() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with Interrupt(signal.SIGINT, signal.SIGTERM):
        assert signal.getsignal(signal.SIGTERM) is not before[1]
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_without_signals_nothing_is_caught() -> None:
    with Interrupt(), pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_other_threads_cannot_and_need_not_listen() -> None:
    seen = []

    def enter() -> None:
        with Interrupt(signal.SIGINT) as interrupt:
            seen.append(interrupt.number)

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert seen == [None]
