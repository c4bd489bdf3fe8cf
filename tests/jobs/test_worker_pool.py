"""Workers that die at any moment: each input has one result, and only what kills them fails."""

import logging
import os
import random
import signal
from collections import Counter, deque
from collections.abc import Hashable, Iterator, Sequence
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import cv2
import pytest
from helpers.batches import pictures, request
from hypothesis import given
from hypothesis import strategies as st

from depthcli._version import __version__
from depthcli.errors import EngineError
from depthcli.io.formats.table import Format
from depthcli.io.listing.folder import InputFile
from depthcli.io.manifest import FAILED, OK, CacheKey, ManifestRow
from depthcli.jobs.batch.ray import (
    LOCAL_CLUSTER,
    Call,
    RemoteWorker,
    WorkerPool,
    _connect,
    _worker_capacity,
)
from depthcli.jobs.batch.tasks import BatchResult, BatchTask
from depthcli.jobs.batch.workers import WorkerSpec

ORIGIN = CacheKey("0" * 64, "tiny", "1" * 64, "1.0")


class Machines:
    """Workers that do their calls in order, and die of some inputs, or by themselves."""

    def __init__(self, seed: int, poison: set[str], deaths: int = 0, false_starts: int = 0) -> None:
        self.random, self.poison = random.Random(seed), poison  # noqa: S311
        self.deaths, self.false_starts = deaths, false_starts
        self.numbers = count()
        self.loads: dict[int, deque[tuple[int, Call]]] = {}
        self.starting: dict[int, int] = {}  # future -> worker
        self.landing: dict[int, object] = {}
        self.begun = self.most = self.lost = 0
        self.ended: list[Hashable] = []
        self.waited: list[Sequence[Hashable]] = []

    def start_worker(self) -> tuple[int, int]:
        self.begun += 1
        worker, future = next(self.numbers), next(self.numbers)
        self.starting[future] = worker
        return worker, future

    def submit(self, worker: Hashable, call: Call) -> int:
        assert isinstance(worker, int)
        future, load = next(self.numbers), self.loads[worker]
        others = [one for _, one in load]
        assert not others or not (call.lost_workers or others[0].lost_workers), "suspects are alone"
        load.append((future, call))
        self.most = max(self.most, len(load))
        return future

    def wait_any(self, futures: Sequence[Hashable]) -> Hashable:
        under_way = {future for load in self.loads.values() for future, _ in load}
        assert set(futures) == under_way | self.starting.keys() | self.landing.keys()
        busy = [worker for worker, load in self.loads.items() if load]
        chosen = self.random.choice([*self.landing, *self.starting, *busy])
        if chosen in self.starting:
            worker = self.starting.pop(chosen)
            self.landing[chosen] = self._start(worker)
        elif chosen not in self.landing:
            chosen = self._work(chosen)
        return chosen

    def _start(self, worker: int) -> object:
        if self.false_starts:
            self.false_starts -= 1
            return OSError("first line\nno such module")
        self.loads[worker] = deque()
        return ORIGIN

    def _work(self, worker: int) -> int:
        future, call = self.loads[worker][0]
        tasks = [task for chunk in call.chunks for task in chunk]
        dies = any(task.input.name in self.poison for task in tasks)
        if not dies and self.deaths and self.random.random() < 0.5:
            self.deaths -= 1
            dies = True
        if dies:
            self.lost += 1
            died = self.loads.pop(worker)
            self.landing |= {future: OSError("the worker died") for future, _ in died}
        else:
            self.loads[worker].popleft()
            self.landing[future] = [
                BatchResult(ManifestRow(t.input.name, OK, ORIGIN)) for t in tasks
            ]
        return future

    def result(self, future: Hashable) -> object:
        assert isinstance(future, int)
        return self.landing.pop(future)

    def kill(self, worker: Hashable) -> None:
        self.ended.append(worker)

    def wait_all(self, futures: Sequence[Hashable]) -> None:
        self.waited.append(futures)


def calls(names: Sequence[str], size: int = 1) -> Iterator[Call]:
    tasks = [BatchTask(InputFile(name, f"in/{name}"), {Format.PNG16: Path(name)}) for name in names]
    for start in range(0, len(tasks), size):
        yield Call(chunks=tuple((task,) for task in tasks[start : start + size]))


@given(
    seed=st.integers(0, 2**32),
    inputs=st.integers(0, 25),
    poison=st.sets(st.integers(0, 24), max_size=3),
    deaths=st.integers(0, 1),  # an innocent may have lost a worker beside what killed it
    false_starts=st.integers(0, 2),
    workers=st.integers(1, 4),
    size=st.integers(1, 3),
)
def test_each_input_has_one_result_and_no_bystander_fails(
    seed: int,
    inputs: int,
    poison: set[int],
    deaths: int,
    false_starts: int,
    workers: int,
    size: int,
) -> None:
    names = [str(number) for number in range(inputs)]
    deadly = {name for name in names if int(name) in poison}
    machines = Machines(seed, deadly, deaths, false_starts)
    pool = WorkerPool(machines)
    results = [one.row for many in pool.results(calls(names, size), workers) for one in many]
    assert Counter(row.input for row in results) == Counter(names)
    assert {row.input for row in results if row.status == FAILED} == deadly
    for row in results:
        if row.status == FAILED:
            assert row.key == ORIGIN
            assert f"in/{row.input}: 3 worker processes ended" in str(row.error)
    assert machines.lost <= 3 * len(deadly) + deaths
    assert machines.begun == (
        machines.lost + workers + false_starts - machines.false_starts if names else 0
    )
    pool.close()
    assert set(machines.ended) == machines.loads.keys() | set(machines.starting.values())
    assert machines.waited == [[]]


def test_a_worker_has_one_call_at_work_and_one_on_its_way() -> None:
    machines = Machines(0, set())
    assert len(list(WorkerPool(machines).results(calls([str(n) for n in range(20)]), 3))) == 20
    assert (machines.begun, machines.most) == (3, 2)


def test_a_pool_that_is_closed_ends_its_workers_and_waits_for_what_they_did() -> None:
    machines = Machines(0, set())
    pool = WorkerPool(machines)
    results = pool.results(calls([str(n) for n in range(20)]), 2)
    next(results)
    pool.close()
    assert sorted(map(str, machines.ended)) == sorted(
        map(str, [*machines.loads, *machines.starting.values()])
    )
    under_way = {future for load in machines.loads.values() for future, _ in load}
    (waited,) = machines.waited
    assert under_way
    assert set(waited) == under_way


def test_workers_that_never_begin_are_given_up() -> None:
    machines = Machines(0, set(), false_starts=9)
    with pytest.raises(EngineError):
        list(WorkerPool(machines).results(calls(["a"]), 1))
    assert machines.begun == 3


def test_a_worker_takes_the_folder_and_the_threads_that_it_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures(tmp_path)
    for name in ("out", "began"):
        (tmp_path / name).mkdir()
    found, threads = request(tmp_path), cv2.getNumThreads()
    spec = WorkerSpec(found.model, found.model.load().model.sha256, found.options, found.plan.out)
    monkeypatch.chdir(tmp_path)
    try:
        for folder, given, taken in (("began", 0.5, 1), ("nowhere", 3, 3)):
            RemoteWorker(spec, str(tmp_path / folder), given).start(__version__)
            assert (Path.cwd(), cv2.getNumThreads()) == (tmp_path / "began", taken)
    finally:
        cv2.setNumThreads(threads)


def test_a_video_that_lost_its_worker_stays_one_call() -> None:
    video = BatchTask(InputFile("a.mp4", "in/a.mp4"), {})
    assert list(Call(video=video, lost_workers=1).split()) == [Call(video=video, lost_workers=2)]


@pytest.mark.parametrize(
    ("cpus", "gpus", "workers"), [(1, 0, 7), (2, 0, 3), (0.5, 0, 15), (1, 1, 2), (0, 0.5, 4)]
)
def test_worker_capacity_of_nodes(cpus: float, gpus: float, workers: int) -> None:
    nodes = [
        {"Alive": True, "Resources": {"CPU": 4.0, "memory": 9e9}},
        {"Alive": True, "Resources": {"CPU": 3.5, "GPU": 2.0}},
        {"Alive": False, "Resources": {"CPU": 64.0, "GPU": 8.0}},
        {"Alive": True, "Resources": {}},
    ]
    assert _worker_capacity(SimpleNamespace(nodes=lambda: nodes), cpus, gpus) == workers


def test_a_cluster_of_this_machine_alone_is_told_to_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RAY_USAGE_STATS_ENABLED", raising=False)
    asked: dict[str, dict[str, object]] = {}

    def init(address: str, **how: object) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # as Ray itself takes it over
        asked[address] = how

    before = signal.getsignal(signal.SIGTERM)
    for address in ("127.0.0.1:6379", "local"):
        assert "RAY_USAGE_STATS_ENABLED" not in os.environ
        _connect(SimpleNamespace(init=init), address)
        assert signal.getsignal(signal.SIGTERM) == before
    assert os.environ["RAY_USAGE_STATS_ENABLED"] == "0"
    quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
    assert asked == {"127.0.0.1:6379": quiet, "local": quiet | LOCAL_CLUSTER}
    assert (LOCAL_CLUSTER["include_dashboard"], LOCAL_CLUSTER["_node_ip_address"]) == (
        False,
        "127.0.0.1",
    )


def test_a_machine_without_this_version_or_the_folder_is_named(tmp_path: Path) -> None:
    pictures(tmp_path)
    found = request(tmp_path)
    spec = WorkerSpec(found.model, "0" * 64, found.options, found.plan.out)
    with pytest.raises(EngineError):
        RemoteWorker(spec, ".", 1).start("0.0.1")
    with pytest.raises(EngineError):
        RemoteWorker(spec, ".", 1).start(__version__)
