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
        function: can be pickled, as can its items and results.
        items: of any length; a few for each worker are in memory at a time.
        workers: processes; with fewer than two, the calling process does the work.

    Yields:
        One result for each item, as :func:`~depthcli.core.parallel.ordered_map.ordered_map` does.
    """
    if workers <= 1:
        yield from map(function, items)
        return
    # A signal ends this process at once; the resource tracker then warns of the pool's semaphores.
    sys.warnoptions.append("ignore:resource_tracker:UserWarning")
    context = multiprocessing.get_context("spawn")  # a fork would copy locks held by threads
    with ProcessPoolExecutor(workers, context, initializer=_start_worker) as pool:
        yield from ordered_map(
            lambda item: pool.submit(function, item).result(), items, workers=2 * workers
        )


def _start_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process ends its workers
    Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    """Exit when the parent was killed; else the worker would wait for work forever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
