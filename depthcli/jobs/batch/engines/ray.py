"""Running a batch on a Ray cluster; each worker is a process that loads the model once.

Plain actors rather than Ray Data: a dead worker must cost only its own pictures, a picture that
kills its worker must fail alone, and results must reach the journal call by call.
"""

import logging
import os
import signal
import socket
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any

from depthcli._version import __version__
from depthcli.core.extras import INSTALL_RAY
from depthcli.core.progress import NO_PROGRESS, Progress
from depthcli.core.text import one_line
from depthcli.errors import DepthcliError, EngineError, UsageError
from depthcli.jobs.batch.engines.pool import WorkerPool
from depthcli.jobs.batch.engines.remote_worker import Call, RemoteWorker
from depthcli.jobs.batch.pictures import PictureTask
from depthcli.jobs.batch.task import Result
from depthcli.jobs.batch.videos import VideoTask
from depthcli.jobs.batch.worker_spec import WorkerSpec

_CHUNKS_PER_CALL = 8
_CONNECT_TIMEOUT_S = 5.0
_SHUTDOWN_TIMEOUT_S = 5.0
_POLL_INTERVAL_S = 0.5
_SPECIAL_ADDRESSES = ("auto", "local")
LOCAL_CLUSTER: dict[str, Any] = {
    "include_dashboard": False,
    "object_store_memory": 100_000_000,  # pictures go through files
    "_node_ip_address": "127.0.0.1",
}
"""Options of ``ray.init`` for a cluster of this machine only, which no other can reach."""


class RayEngine:
    """An :class:`depthcli.jobs.batch.engines.engine.Engine`, connected to a cluster."""

    def __init__(
        self,
        address: str | None = None,
        *,
        workers: int | None = None,
        cpus: float = 1,
        gpus: float = 0,
        progress: Progress = NO_PROGRESS,
    ) -> None:
        """Connect.

        Args:
            address: ``host:port``, ``ray://host:port``, or ``local`` to start a cluster on this
                machine; None for ``RAY_ADDRESS``, or the cluster that this machine belongs to.
            workers: number of workers; None for as many as the cluster has free resources for.
            cpus: per worker.
            gpus: per worker.
            progress: called with 0 while waiting, so that it can stop the work by raising.

        Raises:
            UsageError: Ray is not installed.
            EngineError: there is no such cluster, it has another version of Ray or Python, or no
                machine of it has room for a worker.
        """
        try:
            import ray  # noqa: PLC0415 - an extra
        except ImportError:
            raise UsageError(f"--engine ray needs Ray; {INSTALL_RAY}") from None
        address = address or os.environ.get("RAY_ADDRESS") or "auto"
        if address not in _SPECIAL_ADDRESSES:
            _check_reachable(address)
        self._ray, self._is_own = ray, not ray.is_initialized()
        if self._is_own:
            _connect(ray, address)
        self._cpus, self._gpus = cpus, gpus
        self._poll = progress.begin("", None)
        self._workers = workers or _worker_capacity(ray, cpus, gpus)
        if not self._workers:
            self.close()
            raise EngineError(
                f"no machine of the Ray cluster has {cpus:g} CPUs and {gpus:g} GPUs; change "
                "--cpus-per-worker or --gpus-per-worker, or give --workers to wait for more"
            )

    def close(self) -> None:
        """Disconnect, unless Ray was initialized by the caller."""
        if self._is_own:
            self._ray.shutdown()

    def run(
        self,
        spec: WorkerSpec,
        chunks: Iterable[Sequence[PictureTask]],
        videos: Iterable[VideoTask],
        record: Callable[[Sequence[Result]], None],
    ) -> Generator[Result, None, None]:
        """Process pictures and videos, as every engine does.

        Raises:
            EngineError: workers die at start, or a machine lacks the version or files they need.
            ModelError: the network fails on any picture.
        """
        own = self._ray.remote(num_cpus=self._cpus, num_gpus=self._gpus, max_restarts=0)
        kind = own(RemoteWorker)
        here = os.getcwd()  # noqa: PTH109
        pool = WorkerPool(
            _Actors(self._ray, lambda: kind.remote(spec, here, self._cpus), self._poll)
        )
        rest = iter(chunks)
        groups = iter(lambda: tuple(islice(rest, _CHUNKS_PER_CALL)), ())
        calls = chain(map(Call, groups), (Call(video=video) for video in videos))
        try:
            for results in pool.results(calls, self._workers):
                record(results)
                yield from results
        finally:
            pool.close()


@dataclass(frozen=True, slots=True)
class _Actors:
    """Ray actors as a :class:`depthcli.jobs.batch.engines.pool.Cluster`."""

    ray: Any
    make: Callable[[], Any]
    poll: Callable[[int], object]

    def start_worker(self) -> tuple[Any, Any]:
        worker = self.make()
        return worker, worker.start.remote(__version__)

    def submit(self, worker: Any, call: Call) -> Any:  # noqa: ANN401 - Ray's own
        return worker.work.remote(call)

    def wait_any(self, futures: Sequence[Any]) -> Any:  # noqa: ANN401
        while not (landed := self.ray.wait(futures, num_returns=1, timeout=_POLL_INTERVAL_S)[0]):
            self.poll(0)
        return landed[0]

    def result(self, future: Any) -> object:  # noqa: ANN401
        try:
            return self.ray.get(future)
        except self.ray.exceptions.RayTaskError as error:
            cause = error.cause
            if isinstance(cause, DepthcliError):
                raise cause from None
            raise EngineError(
                one_line(f"a worker of the Ray cluster failed: {type(cause).__name__}: {cause}")
            ) from error
        except self.ray.exceptions.RayError as error:
            return error

    def kill(self, worker: Any) -> None:  # noqa: ANN401
        self.ray.kill(worker)

    def wait_all(self, futures: Sequence[Any]) -> None:
        if futures:
            self.ray.wait(futures, num_returns=len(futures), timeout=_SHUTDOWN_TIMEOUT_S)


def _connect(ray: Any, address: str) -> None:  # noqa: ANN401 - a module
    how = {"log_to_driver": False, "logging_level": logging.ERROR}
    if address == "local":
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # no telemetry
        how |= LOCAL_CLUSTER
    with _preserve_sigterm_handler():
        try:
            ray.init(address, **how)
        except ConnectionError as error:
            where = "on this machine" if address == "auto" else f"at {address}"
            raise EngineError(
                f"no Ray cluster {where}; start one with 'ray start --head', name one with "
                "--ray-address HOST:PORT, or let --ray-address local start one for this batch"
            ) from error
        except (RuntimeError, ValueError, OSError, ray.exceptions.RayError) as error:
            said = " ".join(str(error).split())
            raise EngineError(one_line(f"cannot join the Ray cluster {address}: {said}")) from error


def _check_reachable(address: str) -> None:
    """Try to connect first; Ray itself would retry for a minute, then end the process."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdecimal():
        raise UsageError(f"--ray-address {address} is not HOST:PORT, ray://HOST:PORT or local")
    try:
        socket.create_connection((host.strip("[]"), int(port)), _CONNECT_TIMEOUT_S).close()
    except (OSError, OverflowError) as error:
        raise EngineError(
            f"no Ray cluster at {address}: {error}; see --ray-address, and 'ray status' there"
        ) from error


@contextmanager
def _preserve_sigterm_handler() -> Iterator[None]:
    """Restore the SIGTERM handler, which removes temporary files and which Ray replaces."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, before)


def _worker_capacity(ray: Any, cpus: float, gpus: float) -> int:  # noqa: ANN401 - a module
    """Number of workers that the cluster has resources for."""
    count = 0
    for node in ray.nodes():
        has = node["Resources"] if node["Alive"] else {}
        rooms = [has.get(name, 0) // each for name, each in (("CPU", cpus), ("GPU", gpus)) if each]
        count += int(min(rooms, default=0))
    return count
