"""Threads change how long a map takes, never what it gives."""

import threading
import time
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from depthcli.core.parallel import ordered_map, process_map


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


def test_two_items_for_each_worker_are_pulled_by_default() -> None:
    pulled = iter(range(1000))
    results = ordered_map(str, pulled, workers=3)
    assert next(results) == "0"
    results.close()
    assert next(pulled) == 6


def test_workers_work_at_the_same_time() -> None:
    both = threading.Barrier(2, timeout=10)
    results = ordered_map(lambda _: both.wait(), range(4), workers=2)
    assert sorted(results) == [0, 0, 1, 1]


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


def test_items_not_started_are_dropped_at_an_early_end() -> None:
    begun, go_on = list[int](), threading.Event()

    def work(item: int) -> int:
        begun.append(item)
        if item:
            go_on.wait(10)
        return item

    results = ordered_map(work, range(100), workers=2, ahead=20)
    assert next(results) == 0
    threading.Timer(0.05, go_on.set).start()
    results.close()
    assert set(begun) <= {0, 1, 2}


def test_one_worker_is_this_process() -> None:
    assert list(process_map(lambda n: n + 1, [1, 2], workers=1)) == [2, 3]
