"""Give every reader files that nobody meant to write, and see that none takes the process along.

    python -m robustness.fuzz --mutants 20000 --out /tmp/findings

Mutants are made of good files that the code writes itself; the same number gives the same mutant.
Each has to end in a result or in one of depthcli's own errors, in one line, without a word on
standard error, within 10 seconds of processor time and 1 GiB of memory. What does not is saved in
``--out``, one file for each place where it happened. A file of tests/corpus/TARGET/ is given to
that reader by the ordinary tests.
"""

import argparse
import multiprocessing
import os
import re
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import cv2

from depthcli.errors import DepthcliError
from robustness.fuzz_targets import TARGETS, UNEXPECTED
from robustness.mutants import mutant

OF_LIBRARIES = re.compile(rb"libpng (error|warning): |.*: \(EXR_ERR_|Corrupt JPEG data: ")
"""Lines that libraries print about damage, which their callers cannot prevent."""
_MAX_CPU_S = 10
_MAX_WALL_S = 300
_MAX_GROWTH_KIB = 2**20
_A_WORKER = 300
_FORK = multiprocessing.get_context("fork")  # the libraries are loaded once


class Finding(NamedTuple):
    """One mutant that was not refused as it should be."""

    target: str
    number: int
    what: str
    place: str


def problem(target: str, path: Path) -> tuple[str, str] | None:
    """What a reader did that it should not, and where; None if all is well."""
    try:
        TARGETS[target].read(path)
    except DepthcliError as error:
        message = str(error)
        is_line = message.isprintable() and not UNEXPECTED.search(message) and len(message) < 4000
        return None if is_line else (f"not a line: {message[:300]!r}", type(error).__name__)
    except RecursionError:
        return None  # of brackets in brackets that no program writes: Python's own error is enough
    except Exception as error:  # noqa: BLE001 - which is what is looked for
        frames = traceback.extract_tb(error.__traceback__)
        of_depthcli = [frame for frame in frames if "/depthcli/" in frame.filename] or frames[-1:]
        place = f"{Path(of_depthcli[-1].filename).name}:{of_depthcli[-1].lineno}"
        return f"{type(error).__name__}: {str(error)[:300]}", place
    return None


@cache
def _seeds(target: str) -> list[bytes]:
    return TARGETS[target].seeds()


def file_of(target: str, number: int, folder: Path) -> Path:
    """A mutant, written."""
    path = folder / TARGETS[target].file
    path.write_bytes(mutant(_seeds(target), f"{target}:{number}"))
    return path


def _work(target: str, numbers: range, results: Connection) -> None:
    """Read some mutants in a process of its own; each is announced before it is read."""
    space = 8 * 2**30
    resource.setrlimit(resource.RLIMIT_AS, (space, space))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGVTALRM, signal.SIG_DFL)
    warnings.simplefilter("ignore", ResourceWarning)
    with tempfile.TemporaryFile() as stderr:
        os.dup2(stderr.fileno(), 2)
        for number in numbers:
            results.send(number)
            with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
                path = file_of(target, number, Path(folder))
                before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
                signal.setitimer(signal.ITIMER_VIRTUAL, _MAX_CPU_S)
                failure = problem(target, path)
                signal.setitimer(signal.ITIMER_VIRTUAL, 0)
                grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
            if failure is None and grown > _MAX_GROWTH_KIB:
                failure = f"took {grown // 1024} MiB", "memory"
            stderr.seek(0)
            spoken = [line for line in stderr.read().splitlines() if not OF_LIBRARIES.match(line)]
            stderr.truncate(0)
            stderr.seek(0)
            if failure is None and spoken:
                failure = f"spoke: {spoken[0][:300]!r}", "standard error"
            if failure is not None:
                results.send(Finding(target, number, *failure))
    results.send(None)


def findings(target: str, numbers: range) -> Iterator[Finding]:
    """What goes wrong among some mutants of a target."""
    first = numbers.start
    _seeds(target)  # here, so that workers need not make them again
    while first < numbers.stop:
        ours, theirs = _FORK.Pipe(duplex=False)
        chunk = range(first, min(first + _A_WORKER, numbers.stop))
        worker = _FORK.Process(target=_work, args=(target, chunk, theirs))
        worker.start()
        theirs.close()
        at, is_done = first - 1, False
        try:
            while ours.poll(_MAX_WALL_S):
                message: Any = ours.recv()
                if message is None:
                    is_done = True
                    break
                if isinstance(message, Finding):
                    yield message
                else:
                    at = message
        except EOFError:
            pass
        if not is_done and worker.is_alive() and not ours.poll(1):
            worker.kill()
        worker.join()
        if not is_done:
            code = -(worker.exitcode or 0)
            name = signal.Signals(code).name if code > 0 else f"exit {worker.exitcode}"
            yield Finding(target, at, f"the process ended by {name}", name)
        first = chunk.stop if is_done else at + 1


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--mutants", type=int, default=20_000, help="of all targets together")
    parser.add_argument("--first", type=int, default=0, help="number of the first of each target")
    parser.add_argument("--only", nargs="*", default=[*TARGETS], help="targets")
    parser.add_argument("--out", type=Path, default=Path("fuzz-findings"))
    options = parser.parse_args()
    cv2.setNumThreads(1)  # threads of a pool would not be there in a worker
    total = sum(TARGETS[name].share for name in options.only)
    counts: Counter[tuple[str, str]] = Counter()
    run = 0
    for name in options.only:
        count = max(1, round(options.mutants * TARGETS[name].share / total))
        for failures in findings(name, range(options.first, options.first + count)):
            counts[name, failures.place] += 1
            if counts[name, failures.place] == 1:
                folder = options.out / name / str(failures.number)
                folder.mkdir(parents=True, exist_ok=True)
                file_of(name, failures.number, folder)
                print(f"{name} {failures.number}: {failures.what} ({failures.place})", flush=True)
        run += count
        print(f"{name}: {count} mutants", flush=True)
    kinds = len(counts)
    print(f"{run} mutants, {counts.total()} findings of {kinds} kinds")
    return min(kinds, 1)


if __name__ == "__main__":
    sys.exit(main())
