"""Work on a stream of items with several threads, in order and in bounded memory."""

from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def ordered_map(
    function: Callable[[_Item], _Result],
    items: Iterable[_Item],
    *,
    workers: int,
    ahead: int | None = None,
) -> Generator[_Result, None, None]:
    """``map`` by threads: results come in the order of the items, however long each takes.

    Items are pulled by the thread that iterates, so an iterator over a video need not be safe for
    threads. Stages are chained by giving one map's results to the next.

    Args:
        function: must release the interpreter lock for threads to help; OpenCV, onnxruntime and
            zlib do.
        items: of any length; at most ``ahead`` are in memory at a time.
        workers: threads; 0 works in the calling thread.
        ahead: items pulled before their results are asked for; None for two for each worker.

    Yields:
        One result for each item. What ``function`` raises is raised here, at that item's turn;
        items not yet begun are dropped then, as they are when the iterator is closed.
    """
    if workers == 0:
        yield from map(function, items)
        return
    ahead = 2 * workers if ahead is None else ahead
    pending: deque[Future[_Result]] = deque()
    pool = ThreadPoolExecutor(workers, thread_name_prefix="depthcli")
    try:
        for item in items:
            pending.append(pool.submit(function, item))
            if len(pending) >= ahead:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
