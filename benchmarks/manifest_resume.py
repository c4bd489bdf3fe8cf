"""What a batch of millions of inputs costs besides reading and writing files.

A manifest and a list of the same inputs are written; then a batch of the list is resumed, in which
every input is done. Each step is a process of its own, which prints its time and its peak memory;
the first is a process that only imports.
Run: ``python benchmarks/manifest_resume.py [--rows 1000000]``
"""

from __future__ import annotations

import hashlib
import multiprocessing
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tools import parse_options, print_cost

from depthcli.io.listing import read_list
from depthcli.io.manifest import OK, WHOLE, CacheKey, Journal, ManifestRow, OutputFile, Shard
from depthcli.jobs.batch.plan import plan_files
from depthcli.jobs.batch.tasks import BatchOptions, TaskBuilder

if TYPE_CHECKING:
    from collections.abc import Callable

ORIGIN = CacheKey("0" * 64, "default", "1" * 64, "1.0.0")


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


def write(out: Path, rows: int) -> None:
    """The manifest."""
    with (out / "manifest.jsonl").open("wb") as file:
        file.writelines(row(number).as_line() for number in range(rows))
        print(f"  bytes of a row: {file.tell() / rows:.0f}")


def write_list(path: Path, rows: int) -> None:
    """A list of the same names."""
    with path.open("w") as file:
        file.writelines(f"{name(number)}\n" for number in range(rows))


def resume(out: Path, path: Path, shard: Shard) -> None:
    """What a batch does for inputs that are done: the plan, earlier rows, tasks, the manifest."""
    steps: list[Any] = []

    def step(what: str, action: Callable[[], object]) -> Any:  # noqa: ANN401 - of any step
        print_cost(f"  {what}", lambda: steps.append(action()), len(plan.inputs) if steps else 1)
        return steps[-1]

    plan = step("plan", lambda: plan_files(read_list(str(path)), "list", ".", out, shard=shard))
    journal = step("earlier rows", lambda: Journal(out, shard, plan.names.names))
    tasks = TaskBuilder(plan, BatchOptions(), journal)
    listed = step("tasks", lambda: sum(tasks.task(file).is_listed for file in plan.inputs))
    if listed != len(plan.inputs):
        raise SystemExit("a row is missing")
    step("manifest", lambda: journal.finish(file.name for file in plan.inputs))


def apart(what: str, action: Callable[[], None], rows: int) -> None:
    """Time and peak memory of an action in a process of its own."""
    process = multiprocessing.get_context("fork").Process(
        target=print_cost, args=(what, action, rows)
    )
    process.start()
    process.join()
    if process.exitcode:
        raise SystemExit(what)


def main() -> None:
    """Measure and print."""
    options = parse_options(__doc__, rows=1_000_000)
    rows = options.rows
    with tempfile.TemporaryDirectory() as folder:
        out, listed = Path(folder) / "out", Path(folder) / "list.txt"
        out.mkdir()
        steps: dict[str, Callable[[], None]] = {
            "imports": lambda: None,
            "write the manifest": partial(write, out, rows),
            "write the list": partial(write_list, listed, rows),
            "resume one shard of 100": partial(resume, out, listed, Shard(1, 100)),
            "resume all": partial(resume, out, listed, WHOLE),
        }
        for what, action in steps.items():
            apart(what, action, rows)


if __name__ == "__main__":
    main()
