"""Running a batch on a Ray cluster; each worker is a process that loads the model once.

Plain actors rather than Ray Data: a dead worker must cost only its own images, an image that
kills its worker must fail alone, and results must reach the journal call by call.

A worker has one call at a time. When it dies, the inputs of the call are retried one by one, so
that an input that kills its worker is identified and no other one is blamed.
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any

import cv2

from depthcli._version import __version__
from depthcli.core.options import INSTALL_RAY, one_line
from depthcli.core.parallel import NO_PROGRESS, Progress
from depthcli.errors import DepthcliError, EngineError, InputError, UsageError
from depthcli.io.manifest import CacheKey
from depthcli.io.storage.paths import RemotePath
from depthcli.jobs.batch import plan, tasks
from depthcli.jobs.batch.workers import Chunks, Record, Worker, WorkerSpec


@dataclass(frozen=True, slots=True)
class Call:
    """One request to a worker: chunks of images, or a video."""

    chunks: tuple[Sequence[tasks.BatchTask], ...]
    lost_workers: int = 0  #: workers that died with it

    def split(self) -> Iterator[Call]:
        """One call for each input, after its worker was lost."""
        for task in chain(*self.chunks):
            yield Call(((task,),), self.lost_workers + 1)

    @property
    def task(self) -> tasks.BatchTask:
        """The first input."""
        return self.chunks[0][0]


class RemoteWorker:
    """A worker process on a cluster."""

    _worker: Worker

    def __init__(self, spec: WorkerSpec, folder: str, cpus: float) -> None:
        """Store the arguments; :meth:`start` loads the model, so that its errors are received."""
        self._spec, self._folder, self._cpus = spec, folder, max(1, int(cpus))

    def start(self, version: str) -> CacheKey:
        """Load the model, unless this machine has another version or does not see the output."""
        here = socket.gethostname()
        if version != __version__:
            raise EngineError(f"{here} has depthcli {__version__}; install {version} there")
        if Path(self._folder).is_dir():
            os.chdir(self._folder)  # so that relative paths mean the same as for the driver
        out = self._spec.out
        if not isinstance(out, RemotePath) and not out.is_dir():
            raise EngineError(
                f"{here} cannot see {out}", "put inputs and {out} where all machines can"
            )
        cv2.setNumThreads(self._cpus)
        self._worker = self._spec.build()
        return self._worker.key

    def work(self, call: Call) -> list[tasks.BatchResult]:
        """Process the inputs of a call."""
        if plan.holds_many(call.task.input.name):
            return [self._worker.work_many(call.task, self._cpus, NO_PROGRESS)]
        return [result for chunk in call.chunks for result in self._worker.work(chunk)]


_LOSSES = 3


class WorkerPool:
    """Distributes calls to actors of Ray, and replaces those that die."""

    def __init__(self, ray: Any, make: Callable[[], Any], poll: Callable[[int], object]) -> None:  # noqa: ANN401 - a module
        """Take Ray, a function that makes an actor, and one that is called with 0 while waiting."""
        self._ray, self._make, self._poll = ray, make, poll
        #: worker and call of each; None for the call of a worker that starts
        self._futures: dict[Hashable, tuple[Any, Call | None]] = {}
        self._idle: list[Any] = []  # workers without a call
        self._waiting: deque[Call] = deque()  # the next call, after those that lost a worker
        self._key: CacheKey | None = None
        self._failed_starts = 0

    def results(self, calls: Iterator[Call], workers: int) -> Iterator[Sequence[tasks.BatchResult]]:
        """The results of each call, in any order."""
        self._waiting.extend(islice(calls, 1))
        for _ in range(workers if self._waiting else 0):
            self._start_worker()
        # A call of a lost worker is pending, too, until its error is received.
        while self._waiting or any(call for _, call in self._futures.values()):
            while self._waiting and self._idle:
                worker, call = self._idle.pop(), self._waiting.popleft()
                self._futures[worker.work.remote(call)] = worker, call
                self._waiting.extend(() if self._waiting else islice(calls, 1))
            yield from self._next_results()

    def close(self) -> None:
        """Kill all workers, and wait some seconds for their calls to end."""
        for worker in {*self._idle, *(worker for worker, _ in self._futures.values())}:
            self._ray.kill(worker)
        if running := [future for future, (_, call) in self._futures.items() if call]:
            self._ray.wait(running, num_returns=len(running), timeout=_SHUTDOWN_TIMEOUT_S)

    def _next_results(self) -> Iterator[Sequence[tasks.BatchResult]]:
        """Wait for a worker, and yield the results of its call."""
        done: list[Hashable] = []
        while not done:
            done = self._ray.wait(list(self._futures), num_returns=1, timeout=_POLL_INTERVAL_S)[0]
            self._poll(0)
        worker, call = self._futures.pop(done[0])
        result = self._result(done[0])
        if isinstance(result, CacheKey):
            self._key = result
            self._idle.append(worker)
        elif isinstance(result, list):
            self._idle.append(worker)
            yield result
        elif call is None:
            self._handle_failed_start(result)
        else:
            self._start_worker()
            if call.lost_workers + 1 < _LOSSES:
                self._waiting.extendleft(call.split())
            elif self._key is not None:
                problem = f"{_LOSSES} worker processes ended while it was processed"
                advice = "it may need more memory than a worker has"
                error = InputError(f"{call.task.input.path}: {problem}", advice)
                yield [call.task.failed_result(error, self._key, time.perf_counter(), None)]

    def _result(self, future: Hashable) -> object:
        """The result of a future that is done, or the error by which its worker was lost."""
        try:
            return self._ray.get(future)
        except self._ray.exceptions.RayTaskError as error:
            cause = error.cause
            if isinstance(cause, DepthcliError):
                raise cause from None
            raise EngineError(
                one_line(f"a worker of the Ray cluster failed: {type(cause).__name__}: {cause}")
            ) from error
        except self._ray.exceptions.RayError as error:
            return error

    def _start_worker(self) -> None:
        worker = self._make()
        self._futures[worker.start.remote(__version__)] = (worker, None)

    def _handle_failed_start(self, error: object) -> None:
        self._failed_starts += 1
        if self._key is None and self._failed_starts >= _LOSSES:
            lines = str(error).strip().splitlines() or [""]
            raise EngineError(
                f"workers exit before they start ({one_line(lines[-1])}); is depthcli "
                f"{__version__} installed on every machine of the cluster?"
            )
        self._start_worker()


_CHUNKS_PER_CALL = 8
_SHUTDOWN_TIMEOUT_S = 5.0
_POLL_INTERVAL_S = 0.5
LOCAL_CLUSTER: dict[str, Any] = {
    "include_dashboard": False,
    "object_store_memory": 100_000_000,  # images go through files
    "_node_ip_address": "127.0.0.1",
}  #: options of ``ray.init`` for a cluster of this machine only, which no other can reach


class RayEngine:
    """An :class:`depthcli.jobs.batch.workers.Engine`, connected to a cluster."""

    def __init__(
        self,
        address: str | None = None,
        *,
        workers: int | None = None,
        cpus: float = 1,
        gpus: float = 0,
        progress: Progress = NO_PROGRESS,
    ) -> None:
        """Connect to ``host:port``, ``ray://host:port``, or ``local`` to start one on this machine.

        Without an address, to ``RAY_ADDRESS``, or the cluster that this machine belongs to. By
        default, there are as many workers as it has free resources for. While waiting, ``progress``
        is called with 0, so that it can stop the work by raising.
        """
        try:
            import ray  # noqa: PLC0415 - an extra
        except ImportError:
            raise UsageError(f"it needs Ray; {INSTALL_RAY}", option="engine") from None
        address = address or os.environ.get("RAY_ADDRESS") or "auto"
        self._ray, self._is_own = ray, not ray.is_initialized()
        if self._is_own:
            _connect(ray, address)
        self._cpus, self._gpus = cpus, gpus
        self._poll = progress.begin("", None)
        self._workers = workers or _worker_capacity(ray, cpus, gpus)
        if not self._workers:
            self.close()
            raise EngineError(
                f"no machine of the Ray cluster has {cpus:g} CPUs and {gpus:g} GPUs",
                "change {cpus_per_worker} or {gpus_per_worker}, or give {workers} to wait for more",
            )

    def close(self) -> None:
        """Disconnect, unless Ray was initialized by the caller."""
        if self._is_own:
            self._ray.shutdown()

    def run(
        self, spec: WorkerSpec, chunks: Chunks, videos: Iterable[tasks.BatchTask], record: Record
    ) -> Generator[tasks.BatchResult, None, None]:
        """Process images and videos, as every engine does."""
        actor = self._ray.remote(num_cpus=self._cpus, num_gpus=self._gpus, max_restarts=0)
        worker = actor(RemoteWorker)
        here = os.getcwd()  # noqa: PTH109
        pool = WorkerPool(self._ray, lambda: worker.remote(spec, here, self._cpus), self._poll)
        rest = iter(chunks)
        groups = iter(lambda: tuple(islice(rest, _CHUNKS_PER_CALL)), ())
        calls = chain(map(Call, groups), (Call(((task,),)) for task in videos))
        try:
            for results in pool.results(calls, self._workers):
                record(results)
                yield from results
        finally:
            pool.close()


def _connect(ray: Any, address: str) -> None:  # noqa: ANN401 - a module
    how = {"log_to_driver": False, "logging_level": logging.ERROR}
    if address == "local":
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # no telemetry
        how |= LOCAL_CLUSTER
    before = signal.getsignal(signal.SIGTERM)  # it removes temporary files, and Ray replaces it
    try:
        ray.init(address, **how)
    except ConnectionError as error:
        where = "on this machine" if address == "auto" else f"at {address}"
        raise EngineError(
            f"no Ray cluster {where}",
            "start one with 'ray start --head', name one with {ray_address} HOST:PORT, or let "
            "{ray_address} local start one for this batch",
        ) from error
    except (RuntimeError, ValueError, OSError, ray.exceptions.RayError) as error:
        reason = " ".join(str(error).split())
        raise EngineError(one_line(f"cannot join the Ray cluster {address}: {reason}")) from error
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, before)


def _worker_capacity(ray: Any, cpus: float, gpus: float) -> int:  # noqa: ANN401 - a module
    count = 0
    for node in ray.nodes():
        has = node["Resources"] if node["Alive"] else {}
        rooms = [has.get(name, 0) // each for name, each in (("CPU", cpus), ("GPU", gpus)) if each]
        count += int(min(rooms, default=0))
    return count
