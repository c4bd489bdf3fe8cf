"""Workers that come and go, and what each of them has to do: none of it knows of a cluster's kind.

A worker that dies costs the calls that it had. Their inputs are given to other workers one by one,
each to a worker that has nothing else, so that an input that kills its worker is found, and
none that only was beside it is blamed.
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
_CALLS_A_WORKER = 2  # one at work and one on its way


class Cluster(Protocol):
    """Where workers are. What is under way is told apart by anything that can be hashed."""

    def begin(self) -> tuple[Hashable, Hashable]:
        """Ask for a worker: the worker, and its start, which gives an ``Origin``."""

    def send(self, worker: Hashable, call: Call) -> Hashable:
        """Give a worker something to do, which gives a list of results."""

    def first(self, flights: Sequence[Hashable]) -> Hashable:
        """Wait until one of those under way has landed."""

    def landed(self, flight: Hashable) -> object:
        """What one gave, or the error by which its worker was lost.

        Raises:
            DepthcliError: what the worker raised.
        """

    def end(self, worker: Hashable) -> None:
        """End a worker, whatever it does."""

    def wait(self, flights: Sequence[Hashable]) -> None:
        """Wait until all of these have landed, or a while."""


class Pool:
    """Workers that come and go, and what each of them has to do."""

    def __init__(self, cluster: Cluster) -> None:
        self._cluster = cluster
        self._flights: dict[
            Hashable, tuple[Hashable, Call | None]
        ] = {}  # None: a worker that starts
        self._loads: dict[Hashable, list[Call]] = {}  # of the workers that have started
        self._suspects: deque[Call] = deque()  # their workers died
        self._origin: Origin | None = None
        self._false_starts = 0

    def results(self, calls: Iterator[Call], workers: int) -> Iterator[Sequence[Result]]:
        """What becomes of each call, in any order."""
        following = deque(islice(calls, 1))
        for _ in range(workers if following else 0):
            self._hire()
        # A call of a lost worker is under way, too, until that has been told.
        while following or self._suspects or any(call for _, call in self._flights.values()):
            self._fill(following, calls)
            flight = self._cluster.first(list(self._flights))
            worker, call = self._flights.pop(flight)
            found = self._cluster.landed(flight)
            if isinstance(found, Origin):
                self._origin, self._loads[worker] = found, []
            elif call is None:
                self._fail_to_start(found)
            elif isinstance(found, list):
                self._loads[worker].remove(call)
                yield found
            else:
                yield from self._lose(worker, call)

    def close(self) -> None:
        """End all workers, and see that nothing goes on."""
        for worker in {*self._loads, *(worker for worker, _ in self._flights.values())}:
            self._cluster.end(worker)
        self._cluster.wait([flight for flight, (_, call) in self._flights.items() if call])

    def _hire(self) -> None:
        worker, flight = self._cluster.begin()
        self._flights[flight] = (worker, None)

    def _fill(self, following: deque[Call], calls: Iterator[Call]) -> None:
        """Give workers something to do; a call that has lost a worker has the next one alone."""
        for worker, load in self._loads.items():
            if self._suspects:
                if not load:
                    self._send(worker, self._suspects.popleft())
            elif not any(call.losses for call in load):
                while following and len(load) < _CALLS_A_WORKER:
                    self._send(worker, following.popleft())
                    following.extend(islice(calls, 1))

    def _send(self, worker: Hashable, call: Call) -> None:
        self._flights[self._cluster.send(worker, call)] = (worker, call)
        self._loads[worker].append(call)

    def _fail_to_start(self, error: object) -> None:
        """Ask for another worker, unless none can start."""
        self._false_starts += 1
        if self._origin is None and self._false_starts >= _LOSSES:
            lines = str(error).strip().splitlines() or [""]
            raise EngineError(
                f"workers exit before they start ({one_line(lines[-1])}); is depthcli "
                f"{__version__} installed on every machine of the cluster?"
            )
        self._hire()

    def _lose(self, worker: Hashable, call: Call) -> Iterator[Sequence[Result]]:
        """Give a call whose worker died to others, or up."""
        if self._loads.pop(worker, None) is not None:
            self._hire()
        if call.losses + 1 < _LOSSES:
            self._suspects.extend(call.alone())
        elif self._origin is not None:
            error = InputError(
                f"{call.task.input.path}: {_LOSSES} worker processes ended while it was processed; "
                "it may need more memory than a worker has"
            )
            yield [call.task.failed(error, self._origin, time.perf_counter(), None)]
