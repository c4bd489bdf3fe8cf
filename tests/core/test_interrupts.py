"""Signals that end a run, and what is done before a process ends at once."""

import signal
import threading

import pytest

from depthcli.core.progress import Interrupt, exit_hook, run_exit_hooks


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


def test_the_last_action_is_taken_first_and_none_stops_another() -> None:
    done: list[str] = []
    with exit_hook(lambda: done.append("first")):
        with exit_hook(lambda: 1 / 0), exit_hook(lambda: done.append("last")):
            run_exit_hooks()
        assert done == ["last", "first"]
        run_exit_hooks()
    run_exit_hooks()
    assert done == ["last", "first", "first"]
