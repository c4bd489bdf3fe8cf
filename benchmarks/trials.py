"""Runs mutants in copies of one process that has loaded the tests."""

from __future__ import annotations

import contextlib
import gc
import importlib
import multiprocessing
import os
import resource
import signal
import sys
import time
from collections import defaultdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import coverage
from _pytest.runner import runtestprotocol
from graft import Functions, change_values
from mutants import Mutant

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from multiprocessing.connection import Connection

    import pytest

ROOT = Path(__file__).resolve().parents[1]
_FORK = multiprocessing.get_context("fork")
_LEAST_S, _TIMES = 60, 20  # a mutant that runs this much longer than its tests did is noticed
_CPU_S = 30
T = TypeVar("T")


class Place(NamedTuple):
    """A mutant and its module, relative to the tree."""

    module: Path
    mutant: Mutant

    @property
    def at(self) -> str:
        """File and line."""
        return f"{self.module}:{self.mutant.line}"

    @property
    def name(self) -> str:
        """The module as it is imported."""
        return ".".join(self.module.with_suffix("").parts).removesuffix(".__init__")


class Record(NamedTuple):
    """What one run of the tests showed.

    Attributes:
        seconds: of this processor, that each test that passed took.
        lines: of each module, the tests that ran a line of a function.
    """

    seconds: dict[str, float]
    lines: dict[Path, dict[int, list[str]]]

    def tests(self, place: Place, limit_s: float) -> Iterator[str]:
        """The quickest tests that run a mutant, for so many seconds in all."""
        module, mutant = place
        lines = self.lines[module]
        if mutant.function:
            above = range(mutant.line, mutant.function - 1, -1)
            found = set(next((lines[n] for n in above if n in lines), []))
        else:  # runs when the module is loaded, for whoever uses it
            found = set().union(*lines.values()) or set(self.seconds)
        for test in sorted(found & self.seconds.keys(), key=self.seconds.__getitem__):
            limit_s -= self.seconds[test]
            if limit_s < 0:
                return
            yield test


class Trials:
    """A pytest plugin that runs mutants in place of the tests.

    Attributes:
        noticed_by: each mutant's test that failed, or how it ended otherwise; empty if it survived.
    """

    def __init__(self, places: Sequence[Place], limit_s: float) -> None:
        """Take the mutants, and how many seconds of tests are run with each."""
        self._places = places
        self._limit_s = limit_s
        self.noticed_by: dict[Place, str] = {}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Leave out the tests of the built wheel, which no mutant is in."""
        items[:] = [i for i in items if "installed" not in getattr(i, "fixturenames", ())]

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Once the tests are loaded."""
        vars(session.config)["_tmp_path_factory"].getbasetemp()  # one for all
        items = {item.nodeid: item for item in session.items}
        for place in self._places:
            importlib.import_module(place.name)
        self._functions = Functions({str(ROOT / place.module) for place in self._places})
        gc.collect()
        gc.freeze()  # the copies of this process share what they do not change
        record = _apart(lambda: _record(session.items, {p.module for p in self._places}), 3600)
        if not isinstance(record, Record):
            raise SystemExit(f"the tests could not be run: {record}")
        took_s = sum(record.seconds.values())
        print(f"{len(record.seconds)} of {len(items)} tests pass, in {took_s:.0f} s")
        for place in self._places:
            names = list(record.tests(place, self._limit_s))
            tried = place
            if not names:  # a function that runs while the module is loaded, if at all
                tried = Place(place.module, place.mutant._replace(function=0))
                names = list(record.tests(tried, self._limit_s))
            tests = [items[name] for name in names]
            self.noticed_by[place] = end = self._trial(tried, tests, record)
            _, _, before, after, _ = place.mutant
            ended = end or ("SURVIVED" if tried is place else "SURVIVED, no test runs it")
            print(f"{place.at}: {before}  ->  {after}  [{ended}]", flush=True)
        self._doubt(items)
        return True

    def _doubt(self, items: dict[str, pytest.Item]) -> None:
        """Take back what was noticed by tests that fail with the module's own source as well."""
        doubted = defaultdict(list)
        for place, end in self.noticed_by.items():
            if end in items:
                source = (ROOT / place.module).read_text("utf-8")
                same = Mutant(0, min(1, place.mutant.function), "", "", source)
                doubted[Place(place.module, same)].append(place)
        for same, places in doubted.items():
            tests = [items[name] for name in sorted({self.noticed_by[place] for place in places})]
            failed = _apart(partial(self._with, same, tests, first=False), 3600)
            for place in places:
                if self.noticed_by[place] in failed:
                    print(f"fails without a mutant: {self.noticed_by[place]}")
                    self.noticed_by[place] = ""

    def _trial(self, place: Place, tests: list[pytest.Item], record: Record) -> str:
        usual_s = sum(record.seconds[test.nodeid] for test in tests)
        limit_s = max(_LEAST_S, _TIMES * usual_s)
        found = _apart(partial(self._with, place, tests, first=True), limit_s)
        return found if isinstance(found, str) else "".join(found[:1])

    def _with(self, place: Place, tests: list[pytest.Item], *, first: bool) -> list[str]:
        """The tests that fail with a mutant, or the first of them."""
        _, hard = resource.getrlimit(resource.RLIMIT_CPU)
        resource.setrlimit(resource.RLIMIT_CPU, (_CPU_S if first else 3600, hard))
        try:
            self._functions.change(str(ROOT / place.module), place.mutant.source)
            if not place.mutant.function:
                change_values(sys.modules[place.name], place.mutant.source)
        except Exception as error:  # noqa: BLE001
            return [f"loading the module: {type(error).__name__}"]
        failed = []
        for name, passed, _ in _run(tests):
            if not passed:
                failed.append(name)
                if first:
                    break
        return failed


def _run(tests: list[pytest.Item]) -> Iterator[tuple[str, bool, float]]:
    for test, following in zip(tests, [*tests[1:], None], strict=True):
        start = time.process_time()
        reports = runtestprotocol(test, log=False, nextitem=following)
        passed = all(report.passed for report in reports)
        yield test.nodeid, passed, time.process_time() - start


def _record(tests: list[pytest.Item], modules: Iterable[Path]) -> Record:
    files = {module: str(ROOT / module) for module in modules}
    measured = coverage.Coverage(None, config_file=False, include=list(files.values()))
    measured.start()
    seconds = {}
    measured.switch_context(tests[0].nodeid)
    for test, (name, passed, took_s) in zip([*tests[1:], tests[0]], _run(tests), strict=True):
        if passed:
            seconds[name] = took_s
        measured.switch_context(test.nodeid)
    measured.stop()
    data = measured.get_data()
    return Record(seconds, {module: data.contexts_by_lineno(f) for module, f in files.items()})


def _apart(work: Callable[[], T], limit_s: float) -> T | str:
    """The result of some work in a copy of this process, or how it ended without one."""
    hearer, teller = _FORK.Pipe(duplex=False)
    process = _FORK.Process(target=_tell, args=(work, teller))
    process.start()
    teller.close()
    try:
        return hearer.recv() if hearer.poll(limit_s) else "time"
    except EOFError:
        process.join()
        return "time" if process.exitcode == -signal.SIGXCPU else "a crash"
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid or 0, signal.SIGKILL)
        process.join()


def _tell(work: Callable[[], object], teller: Connection) -> None:
    os.setsid()  # so that what it starts can be ended with it
    silence = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(silence, stream)
    try:
        teller.send(work())
    except BaseException as error:  # noqa: BLE001
        teller.send([f"{type(error).__name__} beyond the tests"])
