"""What a manifest of millions of rows costs: writing it, resuming with it, planning its list.

Each step is a process of its own, which tells its time and its peak memory; the first is a process
that only imports. Lookups are those of a resumed batch, in the order of names.
``--no-rewrite`` leaves out the step that reads and writes every row.
Run: ``python benchmarks/manifest_resume.py [--rows 10000000] [--no-rewrite]``
"""

from __future__ import annotations

import hashlib
import multiprocessing
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tools import parse_options, print_cost

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
from depthcli.jobs.batch.plan import plan_files

if TYPE_CHECKING:
    from collections.abc import Callable

    from depthcli.io.manifest import Rows

ORIGIN = CacheKey("0" * 64, "default", "1" * 64, "1.0.0")
LOOKUPS = 100_000


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
    with (out / WHOLE.manifest_name).open("wb") as file:
        file.writelines(row(number).as_line() for number in range(rows))
    print(f"  bytes of a row: {(out / WHOLE.manifest_name).stat().st_size / rows:.0f}")


def resume(out: Path, rows: int) -> None:
    """What a batch does before its first input, and for each."""
    index: list[Rows] = []
    print_cost("  index", lambda: index.append(known_rows(out)), rows)
    numbers = range(rows // 2, min(rows, rows // 2 + LOOKUPS))
    print_cost("  rows in order", partial(look_up, index[0], numbers), len(numbers))


def look_up(index: Rows, numbers: range) -> None:
    """Rows by their names."""
    if any(index.row(name(number)) is None for number in numbers):
        raise SystemExit("a row is missing")


def finish(out: Path, rows: int) -> None:
    """The end of a batch that did one input more."""
    journal = Journal(out)
    journal.add(row(rows))
    journal.finish(map(name, range(rows + 1)))


def write_list(path: Path, rows: int) -> None:
    """A list of the same names."""
    with path.open("w") as file:
        file.writelines(f"{name(number)}\n" for number in range(rows))


def plan(path: Path, shard: Shard) -> None:
    """The plan of a shard from that list."""
    listed = read_list(str(path))
    inputs = plan_files(listed, "list", ".", str(path.with_suffix("")), shard=shard).inputs
    print(f"  inputs: {len(inputs)}")


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
    options = parse_options(__doc__, rows=10_000_000, no_rewrite=False)
    rows = options.rows
    with tempfile.TemporaryDirectory() as folder:
        out, listed = Path(folder) / "out", Path(folder) / "list.txt"
        out.mkdir()
        steps: dict[str, Callable[[], None]] = {
            "imports": lambda: None,
            "write": partial(write, out, rows),
            "resume": partial(resume, out, rows),
            "finish": partial(finish, out, rows),
            "write the list": partial(write_list, listed, rows),
            "plan of 1/100": partial(plan, listed, Shard(1, 100)),
            "plan of all": partial(plan, listed, WHOLE),
        }
        for what, action in steps.items():
            if not (options.no_rewrite and what == "finish"):
                apart(what, action, rows)


if __name__ == "__main__":
    main()
