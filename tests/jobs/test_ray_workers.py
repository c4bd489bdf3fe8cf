"""A worker on a machine of a Ray cluster, and what is asked of the cluster."""

import logging
import os
import signal
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import pytest
from helpers.batches import images, request

from depthcli._version import __version__
from depthcli.errors import EngineError
from depthcli.io.listing import InputFile
from depthcli.jobs.batch.ray import LOCAL_CLUSTER, Call, RemoteWorker, _connect, _worker_capacity
from depthcli.jobs.batch.tasks import BatchTask
from depthcli.jobs.batch.workers import WorkerSpec


def test_a_worker_takes_the_folder_and_the_threads_that_it_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    images(tmp_path)
    for name in ("out", "began"):
        (tmp_path / name).mkdir()
    job, threads = request(tmp_path), cv2.getNumThreads()
    spec = WorkerSpec(job.model, job.model.load().model.sha256, job.options, job.plan.out)
    monkeypatch.chdir(tmp_path)
    try:
        for folder, cores, taken in (("began", 0.5, 1), ("nowhere", 3, 3)):
            RemoteWorker(spec, str(tmp_path / folder), cores).start(__version__)
            assert (Path.cwd(), cv2.getNumThreads()) == (tmp_path / "began", taken)
    finally:
        cv2.setNumThreads(threads)


def test_a_video_that_lost_its_worker_stays_one_call() -> None:
    call = Call(((BatchTask(InputFile("a.mp4", "in/a.mp4"), {}),),))
    assert list(call.split()) == [replace(call, lost_workers=1)]


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
    options: dict[str, dict[str, object]] = {}

    def init(address: str, **how: object) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # as Ray itself takes it over
        options[address] = how

    before = signal.getsignal(signal.SIGTERM)
    for address in ("127.0.0.1:6379", "local"):
        assert "RAY_USAGE_STATS_ENABLED" not in os.environ
        _connect(SimpleNamespace(init=init), address)
        assert signal.getsignal(signal.SIGTERM) == before
    assert os.environ["RAY_USAGE_STATS_ENABLED"] == "0"
    quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
    assert options == {"127.0.0.1:6379": quiet, "local": quiet | LOCAL_CLUSTER}
    assert (LOCAL_CLUSTER["include_dashboard"], LOCAL_CLUSTER["_node_ip_address"]) == (
        False,
        "127.0.0.1",
    )


def test_a_machine_without_this_version_or_the_folder_is_named(tmp_path: Path) -> None:
    images(tmp_path)
    job = request(tmp_path)
    spec = WorkerSpec(job.model, "0" * 64, job.options, job.plan.out)
    with pytest.raises(EngineError):
        RemoteWorker(spec, ".", 1).start("0.0.1")
    with pytest.raises(EngineError):
        RemoteWorker(spec, ".", 1).start(__version__)
