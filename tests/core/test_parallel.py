"""Threads, and interrupts."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest
from hypothesis import given, strategies as st

from depthcli.core import parallel as cores
from depthcli.core.parallel import Interrupt, one_thread_each, ordered_map


@given(st.lists(st.integers()), st.integers(0, 3), st.integers(1, 5))
def test_results_are_those_of_map_in_order(items: list[int], workers: int, ahead: int) -> None:
    def slow_if_even(item: int) -> int:
        time.sleep(0.0001 * (item % 2))
        return 3 * item

    results = ordered_map(slow_if_even, items, workers=workers, ahead=ahead)
    assert list(results) == [3 * item for item in items]


def test_no_more_items_are_pulled_than_fit_in_memory() -> None:
    pulled = 0

    def items() -> Iterator[int]:
        nonlocal pulled
        for number in range(1, 1001):
            pulled = number
            yield number

    for done, _ in enumerate(ordered_map(str, items(), workers=2, ahead=4)):
        assert pulled - done <= 4


def test_an_error_comes_at_its_items_turn() -> None:
    results = ordered_map(lambda item: 1 // item, [1, 1, 0, 1], workers=2)
    assert [next(results), next(results)] == [1, 1]
    with pytest.raises(ZeroDivisionError):
        next(results)


@pytest.mark.parametrize("workers", [0, 2])
def test_a_closed_map_leaves_no_thread(workers: int) -> None:
    before = threading.active_count()
    results = ordered_map(str, range(1000), workers=workers)
    assert next(results) == "0"
    results.close()
    assert threading.active_count() == before


@pytest.mark.parametrize(("workers", "inside"), [(0, 3), (1, 3), (2, 1)])
def test_opencv_keeps_its_threads_unless_workers_need_them(workers: int, inside: int) -> None:
    before = cv2.getNumThreads()
    cv2.setNumThreads(3)
    try:
        with one_thread_each(workers):
            assert cv2.getNumThreads() == inside
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(before)


@pytest.mark.parametrize(
    ("asked", "shared"),
    [
        ((None, None), (8, 1)),
        ((1, None), (1, 8)),
        ((3, None), (3, 2)),
        ((20, None), (20, 1)),
        ((None, 4), (8, 4)),
        ((2, 5), (2, 5)),
    ],
)
def test_each_worker_has_its_share_of_eight_cores(
    monkeypatch: pytest.MonkeyPatch, asked: tuple[int | None, ...], shared: tuple[int, int]
) -> None:
    monkeypatch.setattr(cores, "usable_cores", lambda: 8)
    assert cores.share_cores(*asked) == shared


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs affinity masks")
def test_cores_that_the_process_may_not_use_do_not_count() -> None:
    code = (
        "import os\n"
        "from depthcli.core.parallel import share_cores, usable_cores\n"
        "os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "print(usable_cores(), *share_cores())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert done.stdout.split() == [b"1", b"1", b"1"]


@pytest.mark.parametrize(
    ("text", "usable"),
    [("max 100000", 8), ("150000 100000", 2), ("1000 100000", 1), ("?", 8), (None, 8)],
)
def test_a_quota_of_a_container_limits_the_cores(
    text: str | None, usable: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if text is not None:
        (tmp_path / "cpu.max").write_text(text)
    monkeypatch.setattr(cores, "_CPU_MAX", tmp_path / "cpu.max")
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: set(range(8)), raising=False)
    assert cores.usable_cores() == usable


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
    with cores.exit_hook(lambda: done.append("first")):
        with cores.exit_hook(lambda: 1 / 0), cores.exit_hook(lambda: done.append("last")):
            cores.run_exit_hooks()
        assert done == ["last", "first"]
        cores.run_exit_hooks()
    cores.run_exit_hooks()
    assert done == ["last", "first", "first"]
