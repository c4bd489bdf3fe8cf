"""Threads, and interrupts."""

import itertools
import os
import signal
import threading
import time
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


@pytest.mark.parametrize(("ahead", "most"), [(5, 5), (None, 4)])
def test_no_more_items_are_pulled_than_fit_in_memory(ahead: int | None, most: int) -> None:
    pulled = itertools.count()
    results = ordered_map(str, pulled, workers=2, ahead=ahead)
    assert list(itertools.islice(results, 100)) == [str(number) for number in range(100)]
    assert next(pulled) == 99 + most


def test_an_error_comes_at_its_items_turn() -> None:
    results = ordered_map(lambda item: 1 // item, [1, 1, 0, 1], workers=2)
    assert [next(results), next(results)] == [1, 1]
    with pytest.raises(ZeroDivisionError):
        next(results)


def test_items_that_have_not_begun_and_threads_are_dropped_at_an_early_end() -> None:
    before, begun = threading.active_count(), list[int]()

    def work(item: int) -> None:
        begun.append(item)
        time.sleep(0.1 * bool(item))

    results = ordered_map(work, range(100), workers=2, ahead=20)
    next(results)
    results.close()
    assert len(begun) < 20
    assert threading.active_count() == before


def test_a_result_in_the_background_is_waited_for_and_its_error_is_raised() -> None:
    go_on = threading.Event()
    work = cores.Background(lambda: (go_on.wait(60), threading.current_thread().daemon))
    go_on.set()
    assert [work.result(), work.result()] == [(True, True)] * 2
    failed = cores.Background(lambda: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        failed.result()


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
    ("limits", "shared"),
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
    monkeypatch: pytest.MonkeyPatch, limits: tuple[int | None, ...], shared: tuple[int, int]
) -> None:
    monkeypatch.setattr(cores, "usable_cores", lambda: 8)
    assert cores.share_cores(*limits) == shared


@pytest.mark.parametrize(
    ("text", "usable"),
    [("max 100000", 8), ("150000 100000", 2), ("1000 100000", 1), ("?", 8), (None, 8)],
)
def test_an_affinity_mask_and_a_quota_of_a_container_limit_the_cores(
    text: str | None, usable: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if text is not None:
        (tmp_path / "cpu.max").write_text(text)
    monkeypatch.setattr(cores, "_CPU_MAX", tmp_path / "cpu.max")
    monkeypatch.setattr(os, "cpu_count", lambda: 16)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: set(range(8)), raising=False)
    assert cores.usable_cores() == usable
    monkeypatch.delattr(os, "sched_getaffinity")  # as on macOS and Windows
    assert cores.usable_cores() == (16 if usable == 8 else usable)


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
    with Interrupt(), pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_processes_start_without_ctrl_c() -> None:
    with cores.without_interrupts():
        assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_other_threads_cannot_and_need_not_listen() -> None:
    other = cores.Background(Interrupt(signal.SIGINT).__enter__)
    assert other.result().number is None


def test_the_last_action_is_taken_first_and_none_stops_another() -> None:
    done: list[str] = []
    with cores.exit_hook(lambda: done.append("first")):
        with cores.exit_hook(lambda: 1 / 0), cores.exit_hook(lambda: done.append("last")):
            cores.run_exit_hooks()
        assert done == ["last", "first"]
        cores.run_exit_hooks()
    cores.run_exit_hooks()
    assert done == ["last", "first", "first"]
