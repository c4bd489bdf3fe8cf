"""What a manifest of millions of rows costs: writing it, resuming with it, planning its list.

Each step is a process of its own, which tells its time and its peak memory; the first is a process
that only imports. Lookups are those of a resumed batch, in the order of names, and random ones.
``--no-rewrite`` leaves out the steps that read and write every row.
Run: ``python benchmarks/manifest_resume.py [--rows 10000000] [--no-rewrite]``
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import resource
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.io.listing.path_list import read_list
from depthcli.io.manifest import (
    OK,
    WHOLE,
    CacheKey,
    Journal,
    ManifestRow,
    OutputFile,
    Shard,
    known_rows,
)
from depthcli.jobs.batch.manifests import read_rows, summarize
from depthcli.jobs.batch.plan import plan_files

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

ORIGIN = CacheKey("0" * 64, "default", "1" * 64, "1.0.0")
SEQUENTIAL, SCATTERED = 100_000, 500


def name(number: int) -> str:
    """Names of a usual length, in order."""
    return f"camera-{number // 100_000:05}/{number // 1000 % 100:03}/frame-{number:09}.jpg"


def row(number: int) -> ManifestRow:
    """A row as a batch writes it; checksums do not compress."""
    first, second = (hashlib.sha256(b"%d %d" % (n, number)).hexdigest() for n in (0, 1))
    base = name(number).removesuffix(".jpg")
    files = (OutputFile(f"{base}.depth.png", 181_493 + number % 999, second),)
    camera = "hfov 63.3° (assumed, from the model's card)"
    path = f"/data/{name(number)}"
    return ManifestRow(name(number), OK, ORIGIN, files, 0.02, first, camera=camera, input_path=path)


def write(folder: Path, rows: int) -> None:
    """The manifest."""
    with (folder / WHOLE.manifest_name).open("wb") as file:
        file.writelines(row(number).as_line() for number in range(rows))


def resume(folder: Path, rows: int) -> None:
    """What a batch does before its first input, and for each."""
    start = time.perf_counter()
    known = known_rows(folder)
    print(f"  index              {time.perf_counter() - start:8.1f} s")
    middle = rows // 2
    for what, numbers in (
        ("in order", range(middle, min(rows, middle + SEQUENTIAL))),
        ("scattered", range(0, rows, rows // SCATTERED)),
    ):
        start = time.perf_counter()
        found = [known.row(name(number)) is not None for number in numbers]
        check(all(found), "a row is missing")
        each_us = (time.perf_counter() - start) / len(numbers) * 1e6
        print(f"  a row, {what:<9}   {each_us:8.1f} us")


def finish(folder: Path, rows: int) -> None:
    """The end of a batch that did one input more."""
    journal = Journal(folder)
    journal.add(row(rows))
    journal.finish(map(name, range(rows + 1)))


def sum_up(folder: Path, rows: int) -> None:
    """``depthcli manifest summary``."""
    check(summarize(read_rows(folder)).inputs == rows + 1, "rows are missing")


def write_list(folder: Path, rows: int) -> None:
    """A list of the same names."""
    (folder / "list.txt").write_text("".join(f"{name(number)}\n" for number in range(rows)))


def plan(folder: Path, shard: Shard) -> None:
    """The plan of a shard from that list."""
    found = plan_files(
        read_list(str(folder / "list.txt")), "list", ".", str(folder / "out"), shard=shard
    )
    print(f"  inputs             {len(found.inputs):8}")


def measured(what: str, action: Callable[[], None]) -> None:
    """Time and peak memory of an action in a process of its own."""

    def run() -> None:
        before_s = time.process_time()
        start = time.perf_counter()
        action()
        wall_s, cpu_s = time.perf_counter() - start, time.process_time() - before_s
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000
        print(f"{what:<20} {wall_s:8.1f} s ({cpu_s:.1f} s CPU)  peak {peak_mb:6.0f} MB", flush=True)

    process = multiprocessing.get_context("fork").Process(target=run)
    process.start()
    process.join()
    check(process.exitcode == 0, what)


def check(holds: bool, problem: str) -> None:
    """Stop if something does not hold."""
    if not holds:
        raise SystemExit(problem)


def sizes(folder: Path) -> str:
    """Bytes of the manifest, in all."""
    bytes_ = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    return f"{bytes_ / 1e6:.0f} MB"


def steps(folder: Path, rows: int, *, rewrite: bool) -> Iterator[tuple[str, Callable[[], None]]]:
    """What is measured once there is a manifest."""
    yield "resume", partial(resume, folder / "out", rows)
    if rewrite:
        yield "finish", partial(finish, folder / "out", rows)
        yield "summary", partial(sum_up, folder / "out", rows)
    yield "plan of 1/100", partial(plan, folder / "list", Shard(1, 100))
    yield "plan of all", partial(plan, folder / "list", WHOLE)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=10_000_000)
    parser.add_argument("--no-rewrite", action="store_true")
    options = parser.parse_args()
    print(f"{options.rows:,} rows")
    with tempfile.TemporaryDirectory() as where:
        folder = Path(where)
        (folder / "list").mkdir()
        (folder / "out").mkdir()
        measured("imports", lambda: None)
        measured("write", partial(write, folder / "out", options.rows))
        print(f"  size               {sizes(folder / 'out'):>8}")
        measured("write the list", partial(write_list, folder / "list", options.rows))
        for what, action in steps(folder, options.rows, rewrite=not options.no_rewrite):
            measured(what, action)


if __name__ == "__main__":
    main()
