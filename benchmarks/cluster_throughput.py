"""What a cluster costs and gives: the same batch by one Ray worker and by two.

Both take turns in one process, on one cluster of this machine, each worker with one core. A run is
measured from the first fifth of its results to the last, so that loading is left out. The figures
of merit are images a second of two workers to those of one (at least 1.8 where two cores are
free), and the CPU time of the driver for an input, also for empty files, which workers refuse at
once: it bounds the images a second of one driver.
Run: ``python benchmarks/cluster_throughput.py [--images 300] [--rounds 5] [--empty 10000]``
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path

import ray
from tools import parse_options, print_spread, ratios, write_images

from depthcli.core.parallel import usable_cores
from depthcli.inference.loading import SessionLoader
from depthcli.jobs.batch.plan import plan_folder
from depthcli.jobs.batch.ray import LOCAL_CLUSTER, RayEngine
from depthcli.jobs.batch.run import Batch, BatchRequest

CLUSTER_CORES = 2


def measured(source: Path, out: Path, workers: int) -> tuple[float, float]:
    """Images a second of a batch into a new folder, and CPU milliseconds of this process each."""
    request = BatchRequest(plan_folder(str(source), str(out)), model=SessionLoader(threads=1))
    batch = Batch(request, engine=RayEngine(workers=workers))
    total = batch.tally.total
    for number, _ in enumerate(batch):
        if number == total // 5:
            start_s, start_cpu_s = time.perf_counter(), time.process_time()
        if number == total - 1:
            wall_s, cpu_s = time.perf_counter() - start_s, time.process_time() - start_cpu_s
    count = total - 1 - total // 5
    return count / wall_s, cpu_s / count * 1e3


def main() -> None:
    """Measure and print."""
    options = parse_options(__doc__, images=300, rounds=5, empty=10_000)
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    ray.init("local", num_cpus=CLUSTER_CORES, log_to_driver=False, **LOCAL_CLUSTER)
    rates: dict[int, list[float]] = {1: [], 2: []}
    driver_ms: dict[int, list[float]] = {1: [], 2: []}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_images(folder / "in", options.images)
        (folder / "empty").mkdir()
        for number in range(options.empty):
            (folder / "empty" / f"{number:06}.png").touch()
        for number in range(options.rounds):
            for workers in (1, 2):
                rate, cpu_ms = measured(folder / "in", folder / f"{workers}-{number}", workers)
                rates[workers].append(rate)
                driver_ms[workers].append(cpu_ms)
        _, limit_ms = measured(folder / "empty", folder / "refused", CLUSTER_CORES)
    ray.shutdown()
    print(f"{options.images} images, {usable_cores()} cores, load {os.getloadavg()[0]:.1f}")
    for workers, values in rates.items():
        print_spread(f"workers: {workers}", values, "images/s")
    print_spread("rate of two workers to one", ratios(rates[2], rates[1]))
    print_spread("CPU of the driver for an image", driver_ms[2], "ms")
    print(f"CPU of the driver for an empty file: {limit_ms:.3f} ms")


if __name__ == "__main__":
    main()
