"""Work on a stream of items with several processes, for work that holds the interpreter's lock."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ProcessPoolExecutor
from threading import Thread
from typing import TypeVar

from depthcli.core.parallel.ordered_map import ordered_map

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def process_map(
    function: Callable[[_Item], _Result], items: Iterable[_Item], *, workers: int
) -> Generator[_Result, None, None]:
    """``map`` by processes: results come in the order of the items.

    Args:
        function: it, its items and its results can be pickled.
        items: of any length; a few for each worker are in memory at a time.
        workers: processes; fewer than two work in this one.

    Yields:
        One result for each item, as :func:`~depthcli.core.parallel.ordered_map.ordered_map` does.
    """
    if workers <= 1:
        yield from map(function, items)
        return
    # A signal ends this process at once; that semaphores of the pool go after it is no news.
    sys.warnoptions.append("ignore:resource_tracker:UserWarning")
    context = multiprocessing.get_context("spawn")  # a fork would copy the locks of our threads
    with ProcessPoolExecutor(workers, context, initializer=_begin) as pool:
        yield from ordered_map(
            lambda item: pool.submit(function, item).result(), items, workers=2 * workers
        )


def _begin() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that started us ends us
    Thread(target=_leave_with_parent, daemon=True).start()


def _leave_with_parent() -> None:
    """Else workers of a killed process would wait for work for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
