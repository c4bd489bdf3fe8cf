"""What a cluster costs and gives: the same batch by a thread, by one Ray worker, and by two.

All ways take turns in one process, on one cluster of this machine, each worker with one core. A run
is measured from the first fifth of its results to the last, so that loading is left out. The
figures of merit are ratios: CPU time for a picture, of the driver, the workers and Ray's own
processes together, to that of a thread (the engine's overhead, which hardly depends on what else
the machine does); pictures a second of two Ray workers to those of one (at least 1.8 where two
cores are free); and the CPU time of the driver for an input, measured with empty files, which
workers refuse at once: it bounds the pictures a second of one driver.
The load of the machine is printed: with more than its cores in use, pictures a second are those of
a share of them. For Linux.
Run: ``python benchmarks/cluster_throughput.py [--pictures 300] [--rounds 5]``
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import ray
from tools import write_pictures

from depthcli.core.parallel import usable_cores
from depthcli.inference.loading import SessionLoader
from depthcli.jobs.batch.engine import LocalEngine
from depthcli.jobs.batch.plan import plan_folder
from depthcli.jobs.batch.ray import LOCAL_CLUSTER, RayEngine
from depthcli.jobs.batch.run import Batch, BatchRequest

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from depthcli.jobs.batch.engine import Engine

CLUSTER_CORES = 2


class Run(NamedTuple):
    """One batch."""

    rate: float  #: pictures a second
    cpu_ms: float  #: of all processes for a picture
    driver_ms: float  #: of this one, with what Ray's threads do all the time


class Moment(NamedTuple):
    """When a result was there."""

    s: float
    driver_s: float
    cpu_s: dict[int, float]  #: of each process

    @classmethod
    def now(cls) -> Moment:
        """This moment."""
        return cls(time.perf_counter(), time.process_time(), tree_cpu_s())


def tree_cpu_s() -> dict[int, float]:
    """CPU time so far of this process and each that it has begun."""
    parents, ticks = {}, {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        pid = int(path.parent.name)
        parents[pid], ticks[pid] = int(fields[1]), int(fields[11]) + int(fields[12])

    def is_ours(pid: int) -> bool:
        while pid and pid != os.getpid():
            pid = parents.get(pid, 0)
        return bool(pid)

    return {pid: ticks[pid] / os.sysconf("SC_CLK_TCK") for pid in ticks if is_ours(pid)}


def measured(source: Path, out: Path, loader: SessionLoader, engine: Engine) -> Run:
    """A batch into a new folder."""
    request = BatchRequest(plan_folder(str(source), str(out)), model=loader, workers=1)
    batch = Batch(request, engine=engine)
    first = batch.tally.total // 5
    for number, result in enumerate(batch):
        if result.row.error is not None or result.is_kept:
            raise SystemExit(f"{result.row.input}: {result.row.error or 'was there'}")
        if number == first:
            begin = Moment.now()
        if number == batch.tally.total - 1:
            end = Moment.now()
    count = batch.tally.total - 1 - first
    cpu_s = sum(spent - begin.cpu_s.get(pid, 0.0) for pid, spent in end.cpu_s.items())
    driver_s = end.driver_s - begin.driver_s
    return Run(count / (end.s - begin.s), cpu_s / count * 1e3, driver_s / count * 1e3)


def driver_s(folder: Path, loader: SessionLoader, count: int) -> float:
    """CPU time of this process for an input that workers refuse."""
    (folder / "empty").mkdir()
    for number in range(count):
        (folder / "empty" / f"{number:06}.png").touch()
    plan = plan_folder(str(folder / "empty"), str(folder / "refused"))
    batch = Batch(BatchRequest(plan, model=loader), engine=RayEngine(workers=CLUSTER_CORES))
    next(batch)
    begin_s, passed = time.process_time(), batch.tally.completed
    for _ in batch:
        pass
    return (time.process_time() - begin_s) / (count - passed)


def told(name: str, values: Sequence[float], unit: str) -> None:
    """Median, and the least and the largest."""
    print(
        f"{name:<44} {statistics.median(values):8.2f} {unit:<11} "
        f"({min(values):.2f} to {max(values):.2f})"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--empty", type=int, default=10_000)
    options = parser.parse_args()
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    ray.init("local", num_cpus=CLUSTER_CORES, log_to_driver=False, **LOCAL_CLUSTER)
    loader = SessionLoader(threads=1)
    session = loader.load()
    ways: dict[str, Callable[[], Engine]] = {
        "thread": lambda: LocalEngine(1, session),
        "one": lambda: RayEngine(workers=1),
        "two": lambda: RayEngine(workers=2),
    }
    runs: dict[str, list[Run]] = {name: [] for name in ways}
    with tempfile.TemporaryDirectory() as where:
        folder = Path(where)
        write_pictures(folder / "in", options.pictures)
        for number in range(options.rounds):
            for name, engine in ways.items():
                out = folder / f"{name}-{number}"
                runs[name].append(measured(folder / "in", out, loader, engine()))
        limit_s = driver_s(folder, loader, options.empty)
    ray.shutdown()
    print(f"{options.pictures} pictures, {usable_cores()} cores, load {os.getloadavg()[0]:.1f}")
    for name, found in runs.items():
        told(f"{name}: pictures a second", [run.rate for run in found], "/s")
        told(f"{name}: CPU for a picture", [run.cpu_ms for run in found], "ms")
    told("driver's own CPU for a picture, on Ray", [run.driver_ms for run in runs["two"]], "ms")
    print(f"driver's own CPU for an empty file, on Ray {limit_s * 1e3:11.3f} ms")
    pairs = list(zip(runs["thread"], runs["one"], runs["two"], strict=True))
    told("CPU of one Ray worker to one thread", [o.cpu_ms / t.cpu_ms for t, o, _ in pairs], "times")
    told("rate of one Ray worker to one thread", [o.rate / t.rate for t, o, _ in pairs], "times")
    told("rate of two Ray workers to one", [two.rate / o.rate for _, o, two in pairs], "times")


if __name__ == "__main__":
    main()
