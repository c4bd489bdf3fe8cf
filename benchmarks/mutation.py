"""How many small faults the tests notice.

Figure of merit: the share of mutants (a comparison, an operator, a constant or a flag changed, a
statement or a keyword argument dropped) with which a test fails that runs the changed line, of the
tests of the module's own folder or of those given. All tests run once, to see which lines each of
them runs and how long it takes; then each mutant has a process of its own, in which its module is
loaded with the fault and its tests run, the quickest first, until one fails. No file is changed;
what tests start as new programs has no mutant in it. A test that failed has to pass without a
fault, else it counts as passed.
Run: ``python benchmarks/mutation.py depthcli/core [MORE...] [--sample N] [--seed S] [--tests ...]``
"""

from __future__ import annotations

import ast
import contextlib
import copy
import importlib
import multiprocessing
import os
import random
import resource
import signal
import sys
import tempfile
import time
from functools import partial
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import coverage
import hypothesis
import pytest
from tools import parse_options

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from multiprocessing.connection import Connection
    from types import CodeType

ROOT = Path(__file__).resolve().parents[1]
_FORK = multiprocessing.get_context("fork")
_LEAST_S, _TIMES = 60, 20  # a mutant that runs this much longer than its tests did is noticed
_CPU_S = 30
T = TypeVar("T")
_PAIRS = (
    (ast.Lt, ast.LtE),
    (ast.Gt, ast.GtE),
    (ast.Eq, ast.NotEq),
    (ast.Is, ast.IsNot),
    (ast.In, ast.NotIn),
    (ast.Add, ast.Sub),
    (ast.Mult, ast.Div),
    (ast.And, ast.Or),
)
_OTHER: dict[type[ast.AST], type[ast.AST]] = {
    **dict(_PAIRS),
    **{second: first for first, second in _PAIRS},
    **dict.fromkeys((ast.FloorDiv, ast.Pow), ast.Mult),
}
_NO_RESULT = {"strict", "out", "dst", "copy"}  # arguments that only check or save memory


class Mutant(NamedTuple):
    """A module with one fault."""

    line: int  #: where the fault is, from 1
    function: int  #: the line where the outermost function around it begins; 0 where there is none
    before: str  #: the code that was there
    after: str  #: the code that is there now
    source: str  #: the whole module


def mutants(source: str) -> Iterator[Mutant]:
    """Every fault that is known here, from the top of a module to its end."""
    data = source.encode()
    starts = [0]
    for line in data.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    tree = ast.parse(source)
    functions = sorted(_functions(tree))
    for node, faulty in _faults(tree):
        begin = starts[node.lineno - 1] + node.col_offset
        end = starts[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0)
        new = ast.unparse(faulty)
        if isinstance(faulty, ast.expr) and not isinstance(faulty, ast.Constant):
            new = f"({new})"
        changed = data[:begin] + new.encode() + data[end:]
        within = (first for first, last in functions if first <= node.lineno <= last)
        texts = _line(data[begin:end].decode()), _line(new), changed.decode()
        yield Mutant(node.lineno, next(within, 0), *texts)


def _functions(tree: ast.AST) -> Iterator[tuple[int, int]]:
    """First and last lines of the bodies of all functions, also of those within others."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            yield node.body[0].lineno, node.end_lineno or 0


def _line(code: str) -> str:
    return " ".join(code.split())


def _faults(node: ast.AST) -> Iterator[tuple[ast.expr | ast.stmt, ast.AST]]:
    """Nodes, each with what takes its place."""
    if isinstance(node, (ast.expr, ast.stmt)):
        for faulty in _faulty(node):
            yield node, faulty
    if isinstance(node, ast.If) and isinstance(node.test, (ast.Name, ast.Attribute, ast.Call)):
        yield node.test, ast.UnaryOp(ast.Not(), node.test)
    for child in _behaviour(node):
        yield from _faults(child)


def _behaviour(node: ast.AST) -> Iterator[ast.AST]:
    """The children of a node, without those that only describe."""
    skipped = {"annotation", "returns", "decorator_list", "type_params"}
    if isinstance(node, ast.JoinedStr):  # messages, whose places Python 3.11 does not know
        return
    for name, value in ast.iter_fields(node):
        if name in skipped:
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not _is_without_result(child):
                yield child


def _is_without_result(node: ast.AST) -> bool:
    if isinstance(node, ast.keyword):
        return node.arg in _NO_RESULT
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def _faulty(node: ast.expr | ast.stmt) -> Iterator[ast.AST]:
    match node:
        case ast.Compare(ops=[operator]) if type(operator) in _OTHER:
            yield _with(node, ops=[_OTHER[type(operator)]()])
        case ast.BinOp(op=operator) | ast.BoolOp(op=operator) if type(operator) in _OTHER:
            yield _with(node, op=_OTHER[type(operator)]())
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield operand
        case ast.Constant(value=bool() | int() | float() as value):
            yield ast.Constant(_another(value))
        case ast.Call(keywords=keywords):
            for dropped in keywords:
                if dropped.arg not in _NO_RESULT:
                    yield _with(node, keywords=[k for k in keywords if k is not dropped])
        case ast.stmt() if _is_dropped(node):
            yield ast.Pass()


def _is_dropped(node: ast.stmt) -> bool:
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Call)
    return isinstance(node, (ast.AugAssign, ast.Raise, ast.Continue, ast.Break))


def _another(value: float) -> float:
    if isinstance(value, bool):
        return not value
    return value + 1 if isinstance(value, int) else value * 1.5 or 1.0


def _with(node: ast.AST, **fields: object) -> ast.AST:
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


class Place(NamedTuple):
    """A mutant and its module, relative to the tree."""

    module: Path
    mutant: Mutant

    @property
    def at(self) -> str:
        """File and line."""
        return f"{self.module}:{self.mutant.line}"


class Record(NamedTuple):
    """What one run of the tests showed."""

    seconds: dict[str, float]  #: of this processor, that each test that passed took
    lines: dict[Path, dict[int, list[str]]]  #: of each module, the tests that ran a line
    libraries: set[str]  #: packages that the tests load

    def tests(self, place: Place, limit_s: float) -> Iterator[str]:
        """The quickest tests that run a mutant, for so many seconds in all."""
        module, mutant = place
        lines = self.lines[module]
        if mutant.function:
            above = range(mutant.line, mutant.function - 1, -1)
            tests = set(next((lines[n] for n in above if n in lines), []))
        else:  # runs when the module is loaded, for whoever uses it
            tests = set().union(*lines.values()) or set(self.seconds)
        for test in sorted(tests & self.seconds.keys(), key=self.seconds.__getitem__):
            limit_s -= self.seconds[test]
            if limit_s < 0:
                return
            yield test


class Observer:
    """A pytest plugin that notes how tests end, how long they take and which lines they run.

    Attributes:
        seconds: of each test.
        failed: tests that fail, in order.
        skipped: tests that are skipped.
    """

    def __init__(self, measured: coverage.Coverage | None = None) -> None:
        self.measured = measured
        self.seconds: dict[str, float] = {}
        self.failed: list[str] = []
        self.skipped: list[str] = []

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Leave out the tests of the built wheel, which no mutant is in."""
        items[:] = [i for i in items if "installed" not in getattr(i, "fixturenames", ())]

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Measure a test."""
        if self.measured is not None:
            self.measured.switch_context(item.nodeid)
        start = time.process_time()
        result = yield
        self.seconds[item.nodeid] = time.process_time() - start
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note how a test ended."""
        if not report.passed:
            (self.failed if report.failed else self.skipped).append(report.nodeid)


def recorded(words: list[str], modules: set[Path]) -> Record:
    """What all tests show."""
    files = {module: str(ROOT / module) for module in modules}
    measured = coverage.Coverage(None, config_file=False, include=list(files.values()))
    observer = Observer(measured)
    measured.start()
    pytest.main(words, [observer])
    measured.stop()
    data = measured.get_data()
    lines = {module: data.contexts_by_lineno(file) for module, file in files.items()}
    seconds = observer.seconds
    for name in {*observer.failed, *observer.skipped}:
        del seconds[name]
    files_of = {name: getattr(module, "__file__", "") for name, module in sys.modules.items()}
    libraries = {n for n, file in files_of.items() if "." not in n and "site-packages" in str(file)}
    return Record(seconds, lines, libraries)


def failures(words: list[str], tests: list[str], place: Place | None = None) -> list[str]:
    """The tests that fail; with a mutant, the first of them, or how else it was noticed."""
    if place is not None:
        load_changed(str(ROOT / place.module), place.mutant.source)
        _, hard = resource.getrlimit(resource.RLIMIT_CPU)
        resource.setrlimit(resource.RLIMIT_CPU, (_CPU_S, hard))
        words = [*words, "-x"]
    observer = Observer()
    code = pytest.main([*words, *tests], [observer])
    if observer.failed or code in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
        return observer.failed
    return ["loading the module"]


def load_changed(path: str, source: str) -> None:
    """From now on load a module from other source."""
    unchanged = SourceFileLoader.get_code

    def get_code(loader: SourceFileLoader, name: str) -> CodeType | None:
        if loader.path == path:
            return compile(source, path, "exec", dont_inherit=True)
        return unchanged(loader, name)

    SourceFileLoader.get_code = get_code


def trials(places: list[Place], words: list[str], tests: list[str], limit_s: float) -> list[str]:
    """Each mutant's test that failed, or how it ended otherwise; empty if it survived."""
    modules = {place.module for place in places}
    record = _apart(lambda: recorded([*words, *tests], modules), 3600)
    if not isinstance(record, Record):
        raise SystemExit(f"the tests could not be run: {record}")
    print(f"{len(record.seconds)} tests pass, in {sum(record.seconds.values()):.0f} s")
    for name in sorted(record.libraries):  # the copies of this process share them
        with contextlib.suppress(Exception):
            importlib.import_module(name)
    ends = []
    for place in places:
        module, mutant = place
        names = list(record.tests(place, limit_s))
        is_run = bool(names)
        if not names:  # a function that runs while the module is loaded, if at all
            names = list(record.tests(Place(module, mutant._replace(function=0)), limit_s))
        usual_s = sum(record.seconds[name] for name in names)
        work = partial(failures, words, names, place)
        ends.append("".join(_apart(work, max(_LEAST_S, _TIMES * usual_s))[:1]))
        ended = ends[-1] or ("SURVIVED" if is_run else "SURVIVED, no test runs it")
        print(f"{place.at}: {mutant.before}  ->  {mutant.after}  [{ended}]", flush=True)
    noticing = sorted(record.seconds.keys() & set(ends))
    doubtful = _apart(lambda: failures(words, noticing), 3600) if noticing else []
    for name in doubtful:
        print(f"fails without a mutant: {name}")
    return ["" if end in doubtful else end for end in ends]


def _apart(work: Callable[[], T], limit_s: float) -> T | list[str]:
    """The result of some work in a copy of this process, or how it ended without one."""
    hearer, teller = _FORK.Pipe(duplex=False)
    process = _FORK.Process(target=_tell, args=(work, teller))
    process.start()
    teller.close()
    try:
        return hearer.recv() if hearer.poll(limit_s) else ["time"]
    except EOFError:
        process.join()
        return ["time" if process.exitcode == -signal.SIGXCPU else "a crash"]
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


def sampled(folder: Path, count: int | None, seed: int) -> list[Place]:
    """Mutants of a module, or of a folder's modules: all, or a random sample."""
    path = folder.resolve().relative_to(ROOT)
    modules = sorted(path.rglob("*.py")) if path.is_dir() else [path]
    places = [
        Place(m, mutant) for m in modules for mutant in mutants((ROOT / m).read_text("utf-8"))
    ]
    print(f"{path}: {len(places)} mutants")
    if count and count < len(places):
        places = random.Random(seed).sample(places, count)  # noqa: S311
    return sorted(places, key=lambda place: (place.module, place.mutant.line))


def main() -> None:
    """Run the trials and print how each mutant ended.

    ``--sample`` is how many mutants of each folder are tried (default: all), ``--tests`` what runs
    in place of the tests of the folders, ``--seconds`` the processor time of tests of one mutant.
    """
    options = parse_options(
        f"{__doc__}\n{main.__doc__}",
        rest=("folders", [ROOT / "depthcli" / "core"]),
        sample=int,
        seed=0,
        seconds=10.0,
        tests=[],
    )
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    of_folder = {f: sampled(f, options.sample, options.seed) for f in options.folders}
    tests = sorted({f"tests/{places[0].module.parts[1]}" for places in of_folder.values()})
    hypothesis.settings.register_profile(
        "mutants", database=None, derandomize=True, deadline=None, phases=list(hypothesis.Phase)[:3]
    )
    with tempfile.TemporaryDirectory() as temporary:
        hypothesis.configuration.set_hypothesis_home_dir(temporary)
        words = ["-q", "-s", "-p", "no:cacheprovider", "-o", "tmp_path_retention_policy=none"]
        words += ["--hypothesis-profile", "mutants", "--basetemp", temporary + "/tests"]
        every = [place for places in of_folder.values() for place in places]
        ends = trials(every, words, options.tests or tests, options.seconds)
    noticed_by = dict(zip(every, ends, strict=True))
    for folder, places in of_folder.items():
        ends = [noticed_by[place] for place in places]
        count = sum(map(bool, ends))
        print(f"{folder}: {count} of {len(ends)} noticed ({count / len(ends):.0%})", end=", ")
        print(f"{ends.count('time')} by time")


if __name__ == "__main__":
    main()
