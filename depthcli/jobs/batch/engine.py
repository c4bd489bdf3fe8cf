"""Engines: how workers share a batch; here with threads and processes of this machine.

Threads of one process wait for Python's lock, so that many images on many cores are divided among
processes of four threads: with 16 cores, 273 images/s in place of 110 (docs/performance.md).
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing, nullcontext, suppress
from dataclasses import dataclass
from itertools import islice
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Protocol, Self

from depthcli.core.parallel import (
    NO_PROGRESS,
    Background,
    Progress,
    one_thread_each,
    ordered_map,
    start_worker,
    without_interrupts,
)
from depthcli.errors import EngineError
from depthcli.inference.session import Session
from depthcli.jobs.batch.tasks import BatchResult, BatchTask
from depthcli.jobs.batch.workers import ImageWorker, VideoWorker, WorkerSpec

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

Chunks = Iterable[Sequence[BatchTask]]
Record = Callable[[Sequence[BatchResult]], None]


class Engine(Protocol):
    """Workers on this machine, or on others."""

    def run(
        self, spec: WorkerSpec, chunks: Chunks, videos: Iterable[BatchTask], record: Record
    ) -> Generator[BatchResult, None, None]:
        """Process chunks of images, which a worker processes together, then videos.

        ``record`` is called with the results of a chunk in this process, from any thread, in any
        order, as soon as they are available; recorded results are safe. Yields the results; on this
        machine, in the order of the inputs. All running work is stopped when it is closed.
        """


_CHUNKS_AHEAD = 64  #: chunks per worker that may be done ahead of a slow one; they hold names only


@dataclass(frozen=True, slots=True)
class LocalEngine:
    """An :class:`Engine` of threads, which share the model of their process."""

    workers: int  #: chunks processed in parallel
    session: Session | None = None  #: the model, if it is loaded already
    progress: Progress = NO_PROGRESS  #: advanced for each frame of a video
    processes: int = 1  #: that images are divided among; 1 for this one alone

    def run(
        self, spec: WorkerSpec, chunks: Chunks, videos: Iterable[BatchTask], record: Record
    ) -> Generator[BatchResult, None, None]:
        """Process images, then videos one after another."""
        worker = spec.build(self.session)

        def work(chunk: Sequence[BatchTask]) -> list[BatchResult]:
            results = images.work(chunk)
            record(results)
            return results

        ahead = _CHUNKS_AHEAD * self.workers
        with (
            nullcontext(worker)
            if self.processes == 1
            else WorkerProcesses(spec, self.workers, self.processes, worker) as images,
            one_thread_each(self.workers),
            closing(ordered_map(work, chunks, workers=self.workers, ahead=ahead)) as done,
        ):
            for results in done:
                yield from results
        for task in videos:
            result = VideoWorker(worker, self.workers, self.progress).work(task)
            record((result,))
            yield result


_THREADS = 4  #: of a process; more wait for each other
_LEAST_IMAGES = 200  #: below, starting processes takes longer than they save


def process_count(workers: int, images: Iterable[object]) -> int:
    """Number of processes for workers that process some images."""
    is_worth_it = len(list(islice(images, _LEAST_IMAGES))) == _LEAST_IMAGES
    return -(-workers // _THREADS) if is_worth_it else 1


class WorkerProcesses:
    """Processes that load a model each; used as a context, which ends them.

    Each answers a few connections, in a thread each: a ``ProcessPoolExecutor`` has one call at a
    time in a process, so that each thread would need a model of its own.
    """

    def __init__(self, spec: WorkerSpec, workers: int, count: int, here: ImageWorker) -> None:
        """Start ``count`` processes with as many threads in all as there are workers.

        They stop when the session of the worker of this process is stopped.
        """
        context = multiprocessing.get_context("spawn")  # a fork would copy locks held by threads
        self._free: SimpleQueue[Connection] = SimpleQueue()
        self._processes = []
        for i in range(count):
            pipes = [context.Pipe() for _ in range(i, workers, count)]
            theirs = [end for _, end in pipes]
            process = context.Process(target=_serve, args=(spec, theirs), daemon=True)
            with without_interrupts():
                process.start()
            self._processes.append(process)
            for end in theirs:
                end.close()  # so that the other end tells when the process has ended
            for end, _ in pipes:
                self._free.put(end)
        here.job.pipeline.session.on_stop = self._stop

    def __enter__(self) -> Self:
        """The processes."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the processes, once no image is processed."""
        while not self._free.empty():
            self._free.get().close()
        for process in self._processes:
            process.join()

    def _stop(self) -> None:
        for process in self._processes:
            process.terminate()

    def work(self, chunk: Sequence[BatchTask]) -> list[BatchResult]:
        """Process some images, as :meth:`ImageWorker.work` does, by a process that is free.

        EngineError if the process ends meanwhile.
        """
        end = self._free.get()
        try:
            end.send(chunk)
            answer: list[BatchResult] | Exception = end.recv()
        except (EOFError, OSError) as error:
            names = ", ".join(task.input.path for task in chunk)
            raise EngineError(
                f"a worker process was ended while it processed {names}",
                "if memory is short, use fewer {workers}; the same command resumes",
            ) from error
        finally:
            self._free.put(end)
        if isinstance(answer, Exception):
            raise answer
        return answer


def _serve(spec: WorkerSpec, ends: Sequence[Connection]) -> None:
    start_worker()
    loading = Background(spec.build)
    # Not the end of the process: Slurm and systemd signal the whole group.
    signal.signal(signal.SIGTERM, lambda *_: loading.result().job.pipeline.session.stop())
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
