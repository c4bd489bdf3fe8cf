"""A batch on a real Ray cluster of this machine, with two workers."""

import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.batches import outputs, request
from helpers.tiny import synthetic_image, write_image
from helpers.videos import write_mp4

from depthcli.errors import EngineError, ModelError, UsageError
from depthcli.io.manifest import FAILED, read_rows
from depthcli.jobs.batch.plan import plan_folder
from depthcli.jobs.batch.ray import LOCAL_CLUSTER, RayEngine
from depthcli.jobs.batch.run import Batch, BatchRequest
from depthcli.jobs.batch.tasks import BatchResult
from depthcli.jobs.batch.workers import Engine, WorkerSpec

ray = pytest.importorskip("ray")
COUNT = 30


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """The address of a cluster of two cores."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    before = signal.getsignal(signal.SIGTERM)
    context = ray.init("local", num_cpus=2, log_to_driver=False, **LOCAL_CLUSTER)
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])  # workers do not see the tests
    yield context.address_info["gcs_address"]
    ray.shutdown()
    signal.signal(signal.SIGTERM, before)


@pytest.fixture
def engine(cluster: str) -> Iterator[RayEngine]:
    with closing(RayEngine(cluster)) as connected:
        yield connected
    assert ray.is_initialized(), "the tests connected, not the engine"


def inputs(folder: Path) -> None:
    """Images, no two alike, one of them broken, and a video."""
    for number in range(COUNT):
        write_image(
            folder / "in" / str(number % 2) / f"{number:02}.png", synthetic_image(24, 32 + number)
        )
    (folder / "in" / "bad.png").write_bytes(b"")
    write_mp4(folder / "in" / "clip.mp4", [np.full((48, 64, 3), 9 * n, np.uint8) for n in range(3)])


def worker_pids() -> list[int]:
    """Processes of this process's cluster that do images."""
    pids = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            name = (folder / "cmdline").read_text()
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            above = int(Path(f"/proc/{parent}/stat").read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError):
            continue
        if name.startswith("ray::RemoteWorker") and above == os.getpid():
            pids.append(int(folder.name))
    return pids


def with_a_camera(folder: Path, out: str = "out") -> BatchRequest:
    """A batch whose first image has a camera of its own."""
    table = folder / "cameras.csv"
    table.write_text("id,focal_px\n0/00,40\n")
    plan = plan_folder(str(folder / "in"), str(folder / out), cameras=str(table))
    return replace(request(folder, out), plan=plan)


def assert_same(folder: Path, results: Sequence[BatchResult], by_threads: BatchRequest) -> None:
    """Every input once, with the outputs and rows that threads give."""
    alone = list(Batch(by_threads))
    names = Counter(result.row.input for result in results)
    assert names == Counter(result.row.input for result in alone)
    assert outputs(folder / "out") == outputs(folder / "alone")
    rows, reference = (
        [replace(row, seconds=0) for row in read_rows(folder / out)] for out in ("alone", "out")
    )
    assert reference == rows
    assert [row.input for row in reference if row.status == FAILED] == ["bad.png"]


@pytest.mark.skipif(sys.platform != "linux", reason="workers are found in /proc")
def test_a_worker_that_is_killed_costs_nothing(tmp_path: Path, engine: RayEngine) -> None:
    inputs(tmp_path)
    results = []
    with closing(Batch(with_a_camera(tmp_path), engine=engine)) as batch:
        for result in batch:
            if not results:
                os.kill(worker_pids()[0], signal.SIGKILL)
                (tmp_path / "out" / "0" / ".depthcli-0123456789abcdef.png").touch()  # it may leave
            results.append(result)
    assert_same(tmp_path, results, with_a_camera(tmp_path, "alone"))
    names = [entry.row.input for entry in results if "(given)" in str(entry.row.camera)]
    assert names == ["0/00.png"]
    again = list(Batch(with_a_camera(tmp_path)))  # by threads: an engine is no other option
    assert [result.row.input for result in again if not result.is_kept] == ["bad.png"]


class UnreadableSpec(WorkerSpec):
    __slots__ = ()

    def __reduce__(self) -> Any:
        return __import__, ("nowhere_to_be_found",)


class Changed:
    """An engine whose workers are built from something else."""

    def __init__(self, engine: Engine, kind: type[WorkerSpec], **changes: Any) -> None:
        self.engine, self.kind, self.changes = engine, kind, changes

    def run(self, spec: WorkerSpec, *rest: Any) -> Generator[BatchResult, None, None]:
        fields = {name: getattr(spec, name) for name in WorkerSpec.__slots__}
        return self.engine.run(self.kind(**fields | self.changes), *rest)


@pytest.mark.parametrize(
    ("kind", "changes", "error", "line"),
    [
        (WorkerSpec, {"model_sha256": "0" * 64}, ModelError, "is not the model that this batch"),
        (UnreadableSpec, {}, EngineError, "workers exit before they start .* is depthcli"),
    ],
)
def test_unusable_worker_setup_ends_the_batch(
    tmp_path: Path,
    cluster: str,
    kind: type[WorkerSpec],
    changes: dict[str, Any],
    error: type[Exception],
    line: str,
) -> None:
    inputs(tmp_path)
    changed = Changed(RayEngine(cluster, workers=1), kind, **changes)
    with pytest.raises(error, match=line) as raised:
        list(Batch(request(tmp_path), engine=changed))
    assert "\n" not in str(raised.value)


def test_a_driver_that_is_killed_goes_on(tmp_path: Path, cluster: str, engine: RayEngine) -> None:
    inputs(tmp_path)
    model = str(request(tmp_path).model.model)
    words = ("batch", "in", "-o", "out", "--model", model, "--provider", "cpu", "--json")
    words += ("--engine", "ray", "--ray-address", cluster, "--workers", "1")
    command = [sys.executable, "-m", "depthcli", *words]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout.readline().startswith('{"input": ')
        driver.kill()
    journal = (tmp_path / "out" / ".depthcli-batch.jsonl").read_bytes()
    results = list(Batch(request(tmp_path), engine=engine))
    kept_count = sum(result.is_kept for result in results)
    assert 1 <= kept_count <= journal.count(b"\n") < COUNT
    assert_same(tmp_path, results, request(tmp_path, "alone"))


def test_a_worker_that_no_machine_has_room_for(cluster: str) -> None:
    for needs in ({"cpus": 3}, {"gpus": 1}):
        with pytest.raises(EngineError):
            RayEngine(cluster, **needs)


def test_without_ray_one_line_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(UsageError):
        RayEngine()
