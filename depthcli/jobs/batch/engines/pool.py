"""A pool of workers on a cluster of any kind.

When a worker dies, the inputs of its calls are retried one by one, each on a worker that has no
other call, so that an input that kills its worker is identified and no other one is blamed.
"""

import time
from collections import deque
from collections.abc import Hashable, Iterator, Sequence
from itertools import islice
from typing import Protocol

from depthcli._version import __version__
from depthcli.core.text import one_line
from depthcli.errors import EngineError, InputError
from depthcli.io.manifest.row import Origin
from depthcli.jobs.batch.engines.remote_worker import Call
from depthcli.jobs.batch.task import Result

_LOSSES = 3
_CALLS_PER_WORKER = 2  # one running and one queued


class Cluster(Protocol):
    """Where the workers run. Workers and futures are any hashable objects."""

    def start_worker(self) -> tuple[Hashable, Hashable]:
        """Start a worker; returns it, and a future whose result is its ``Origin``."""

    def submit(self, worker: Hashable, call: Call) -> Hashable:
        """Submit a call to a worker; returns a future whose result is a list of results."""

    def wait_any(self, futures: Sequence[Hashable]) -> Hashable:
        """Wait until one of the futures is done, and return it."""

    def result(self, future: Hashable) -> object:
        """The result of a future that is done, or the error by which its worker was lost.

        Raises:
            DepthcliError: raised by the worker.
        """

    def kill(self, worker: Hashable) -> None:
        """Kill a worker."""

    def wait_all(self, futures: Sequence[Hashable]) -> None:
        """Wait until all of these are done, or for a few seconds."""


class WorkerPool:
    """Distributes calls to workers, and replaces workers that die."""

    def __init__(self, cluster: Cluster) -> None:
        self._cluster = cluster
        self._futures: dict[
            Hashable, tuple[Hashable, Call | None]
        ] = {}  # None: a worker that starts
        self._assigned: dict[Hashable, list[Call]] = {}  # of the workers that have started
        self._suspects: deque[Call] = deque()  # calls whose workers died
        self._origin: Origin | None = None
        self._failed_starts = 0

    def results(self, calls: Iterator[Call], workers: int) -> Iterator[Sequence[Result]]:
        """The results of each call, in any order."""
        following = deque(islice(calls, 1))
        for _ in range(workers if following else 0):
            self._start_worker()
        # A call of a lost worker is pending, too, until its error is received.
        while following or self._suspects or any(call for _, call in self._futures.values()):
            self._assign(following, calls)
            future = self._cluster.wait_any(list(self._futures))
            worker, call = self._futures.pop(future)
            found = self._cluster.result(future)
            if isinstance(found, Origin):
                self._origin, self._assigned[worker] = found, []
            elif call is None:
                self._handle_failed_start(found)
            elif isinstance(found, list):
                self._assigned[worker].remove(call)
                yield found
            else:
                yield from self._handle_lost_worker(worker, call)

    def close(self) -> None:
        """Kill all workers, and wait for their calls to end."""
        for worker in {*self._assigned, *(worker for worker, _ in self._futures.values())}:
            self._cluster.kill(worker)
        self._cluster.wait_all([future for future, (_, call) in self._futures.items() if call])

    def _start_worker(self) -> None:
        worker, future = self._cluster.start_worker()
        self._futures[future] = (worker, None)

    def _assign(self, following: deque[Call], calls: Iterator[Call]) -> None:
        """Submit calls; a call that has lost a worker gets the next one for itself."""
        for worker, load in self._assigned.items():
            if self._suspects:
                if not load:
                    self._submit(worker, self._suspects.popleft())
            elif not any(call.lost_workers for call in load):
                while following and len(load) < _CALLS_PER_WORKER:
                    self._submit(worker, following.popleft())
                    following.extend(islice(calls, 1))

    def _submit(self, worker: Hashable, call: Call) -> None:
        self._futures[self._cluster.submit(worker, call)] = (worker, call)
        self._assigned[worker].append(call)

    def _handle_failed_start(self, error: object) -> None:
        """Start another worker, unless none can start."""
        self._failed_starts += 1
        if self._origin is None and self._failed_starts >= _LOSSES:
            lines = str(error).strip().splitlines() or [""]
            raise EngineError(
                f"workers exit before they start ({one_line(lines[-1])}); is depthcli "
                f"{__version__} installed on every machine of the cluster?"
            )
        self._start_worker()

    def _handle_lost_worker(self, worker: Hashable, call: Call) -> Iterator[Sequence[Result]]:
        """Retry a call whose worker died, or give it up."""
        if self._assigned.pop(worker, None) is not None:
            self._start_worker()
        if call.lost_workers + 1 < _LOSSES:
            self._suspects.extend(call.split())
        elif self._origin is not None:
            error = InputError(
                f"{call.task.input.path}: {_LOSSES} worker processes ended while it was processed; "
                "it may need more memory than a worker has"
            )
            yield [call.task.failed_result(error, self._origin, time.perf_counter(), None)]
