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
from helpers.tiny import synthetic_picture, write_picture
from helpers.videos import write_mp4

from depthcli.core.camera import Intrinsics
from depthcli.errors import EngineError, ModelError, UsageError
from depthcli.inference.session import Session
from depthcli.io.manifest import FAILED, OK
from depthcli.jobs.batch.manifests import read_rows
from depthcli.jobs.batch.plan import CameraTable, plan_folder
from depthcli.jobs.batch.ray import LOCAL_CLUSTER, RayEngine
from depthcli.jobs.batch.run import Batch
from depthcli.jobs.batch.tasks import BatchResult, BatchTask
from depthcli.jobs.batch.workers import Engine, ImageWorker, WorkerSpec

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
    """Pictures, no two alike, one of them broken, and a video."""
    for number in range(COUNT):
        write_picture(
            folder / "in" / str(number % 2) / f"{number:02}.png", synthetic_picture(24, 32 + number)
        )
    (folder / "in" / "bad.png").write_bytes(b"")
    write_mp4(folder / "in" / "clip.mp4", [np.full((48, 64, 3), 9 * n, np.uint8) for n in range(3)])


def worker_pids() -> list[int]:
    """Processes of this process's cluster that do pictures."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            name = (folder / "cmdline").read_text()
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            above = int(Path(f"/proc/{parent}/stat").read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError):
            continue
        if name.startswith("ray::RemoteWorker") and above == os.getpid():
            found.append(int(folder.name))
    return found


def assert_same(folder: Path, results: Sequence[BatchResult]) -> None:
    """Every input once, with the outputs and rows that threads give."""
    alone = list(Batch(request(folder, "alone")))
    names = Counter(result.row.input for result in results)
    assert names == Counter(result.row.input for result in alone)
    assert outputs(folder / "out") == outputs(folder / "alone")
    rows, own = (
        [replace(row, seconds=0) for row in read_rows(folder / out)] for out in ("alone", "out")
    )
    assert own == rows
    assert [row.input for row in own if row.status == FAILED] == ["bad.png"]


@pytest.mark.skipif(sys.platform != "linux", reason="workers are found in /proc")
def test_a_worker_that_is_killed_costs_nothing(tmp_path: Path, engine: RayEngine) -> None:
    inputs(tmp_path)
    results = []
    with closing(Batch(request(tmp_path), engine=engine)) as batch:
        for result in batch:
            if not results:
                os.kill(worker_pids()[0], signal.SIGKILL)
            results.append(result)
    assert_same(tmp_path, results)
    again = list(Batch(request(tmp_path), engine=engine))
    assert [result.row.input for result in again if not result.is_kept] == ["bad.png"]


def test_workers_know_the_camera_of_each_picture(tmp_path: Path, engine: RayEngine) -> None:
    names = ("a.png", "b.png")
    for name in names:
        write_picture(tmp_path / "in" / name)
    table = CameraTable({"a": Intrinsics(40.0)})
    plan = plan_folder(str(tmp_path / "in"), str(tmp_path / "out"), cameras=table)
    results = list(Batch(replace(request(tmp_path), plan=plan), engine=engine))
    cameras = {result.row.input: result.row.camera or "" for result in results}
    assert [cameras[name].partition(" (")[2] for name in names] == [
        "given)",
        "assumed, from the model's card)",
    ]
    assert all(result.is_kept for result in Batch(replace(request(tmp_path), plan=plan)))


class Poisoned(ImageWorker):
    """A worker that a picture kills, as the system does where memory ends."""

    def work(self, tasks: Sequence[BatchTask]) -> list[BatchResult]:
        if any(task.input.name.endswith("07.png") for task in tasks):
            os.kill(os.getpid(), signal.SIGKILL)
        return super().work(tasks)


class PoisonedSpec(WorkerSpec):
    __slots__ = ()

    def build(self, session: Session | None = None) -> ImageWorker:
        worker = super().build(session)
        return Poisoned(worker.options, worker.out, worker.key, worker.pipeline)


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


def test_a_picture_that_kills_its_workers_fails_alone(tmp_path: Path, engine: RayEngine) -> None:
    inputs(tmp_path)
    results = list(Batch(request(tmp_path), engine=Changed(engine, PoisonedSpec)))
    assert Counter(result.row.input for result in results).most_common(1)[0][1] == 1
    failed = {result.row.input: result.row.error for result in results if result.row.status != OK}
    assert failed.keys() == {"bad.png", "1/07.png"}
    assert "worker" in str(failed["1/07.png"])
    assert len(results) == COUNT + 2


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
    one = Changed(RayEngine(cluster, workers=1), kind, **changes)
    with pytest.raises(error, match=line) as raised:
        list(Batch(request(tmp_path), engine=one))
    assert "\n" not in str(raised.value)


def test_a_driver_that_is_killed_goes_on(tmp_path: Path, cluster: str, engine: RayEngine) -> None:
    inputs(tmp_path)
    model = str(request(tmp_path).model.model)
    words = (
        "batch",
        "in",
        "-o",
        "out",
        "--model",
        model,
        "--engine",
        "ray",
        "--ray-address",
        cluster,
    )
    command = [
        sys.executable,
        "-m",
        "depthcli",
        *words,
        "--provider",
        "cpu",
        "--json",
        "--workers",
        "1",
    ]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout.readline().startswith('{"input": ')
        driver.kill()
    journal = (tmp_path / "out" / ".depthcli-batch.jsonl").read_bytes()
    results = list(Batch(request(tmp_path), engine=engine))
    kept = sum(result.is_kept for result in results)
    assert 1 <= kept <= journal.count(b"\n") < COUNT
    assert_same(tmp_path, results)


def test_a_worker_that_no_machine_has_room_for(cluster: str) -> None:
    for needs in ({"cpus": 3}, {"gpus": 1}):
        with pytest.raises(EngineError):
            RayEngine(cluster, **needs)


def test_without_ray_one_line_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(UsageError):
        RayEngine()
