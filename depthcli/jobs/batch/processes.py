"""Worker processes on this machine, for batches of many images on many cores.

Threads of one process wait for Python's lock: with 16 cores, 16 of them reach 2.4 times the speed
of two, four processes of four 6 times (docs/performance.md).

Each process answers a few connections, in a thread each. Not a ``ProcessPoolExecutor``, which has
one call at a time in a process, so that each thread would need a model of its own.
"""

from __future__ import annotations

import multiprocessing
import signal
from contextlib import suppress
from itertools import islice
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Self

from depthcli.core.parallel import Background, one_thread_each, start_worker
from depthcli.errors import EngineError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from multiprocessing.connection import Connection

    from depthcli.jobs.batch.tasks import BatchResult, BatchTask
    from depthcli.jobs.batch.workers import ImageWorker, WorkerSpec

_THREADS = 4  #: of a process; more wait for each other
_LEAST_IMAGES = 200  #: below, starting processes takes longer than they save


def process_count(workers: int, images: Iterable[object]) -> int:
    """Number of processes for workers that process some images."""
    is_worth_it = len(list(islice(images, _LEAST_IMAGES))) == _LEAST_IMAGES
    return -(-workers // _THREADS) if is_worth_it else 1


class WorkerProcesses:
    """Processes that load a model each; used as a context, which ends them."""

    def __init__(self, spec: WorkerSpec, workers: int, count: int) -> None:
        """Start ``count`` processes with as many threads in all as there are workers."""
        context = multiprocessing.get_context("spawn")  # a fork would copy locks held by threads
        self._free: SimpleQueue[Connection] = SimpleQueue()
        self._processes = []
        for i in range(count):
            pipes = [context.Pipe() for _ in range(i, workers, count)]
            theirs = [end for _, end in pipes]
            process = context.Process(target=_serve, args=(spec, theirs), daemon=True)
            process.start()
            self._processes.append(process)
            for end in theirs:
                end.close()  # so that the other end tells when the process has ended
            for end, _ in pipes:
                self._free.put(end)

    def __enter__(self) -> Self:
        """The processes."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the processes, once no image is processed."""
        while not self._free.empty():
            self._free.get().close()
        for process in self._processes:
            process.join()

    def work(self, chunk: Sequence[BatchTask]) -> list[BatchResult]:
        """Process some images, as :meth:`ImageWorker.work` does, by a process that is free.

        EngineError if the process ends meanwhile.
        """
        end = self._free.get()
        try:
            end.send(chunk)
            found: list[BatchResult] | Exception = end.recv()
        except (EOFError, OSError) as error:
            names = ", ".join(task.input.path for task in chunk)
            raise EngineError(
                f"a worker process was ended while it processed {names}",
                "if memory is short, use fewer {workers}; the same command resumes",
            ) from error
        finally:
            self._free.put(end)
        if isinstance(found, Exception):
            raise found
        return found


def _serve(spec: WorkerSpec, ends: Sequence[Connection]) -> None:
    start_worker()
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # Slurm and systemd signal the whole group
    loading = Background(spec.build)
    threads = [Thread(target=_answer, args=(end, loading)) for end in ends]
    with one_thread_each(len(threads)):
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()


def _answer(end: Connection, loading: Background[ImageWorker]) -> None:
    with end, suppress(EOFError, OSError):  # the other end is closed
        while True:
            chunk = end.recv()
            try:
                answer: object = loading.result().work(chunk)
            except Exception as error:  # noqa: BLE001 - raised again by WorkerProcesses.work
                answer = error
            end.send(answer)
