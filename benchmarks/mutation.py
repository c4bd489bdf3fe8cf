"""How many small faults the tests notice.

Figure of merit: the share of mutants (a comparison, an operator, a constant or a flag changed, a
statement or a keyword argument dropped) with which a test fails that runs the changed line, of the
tests of the module's own folder or of those given. All tests are loaded once and run once, to see
which lines each of them runs and how long it takes; then each mutant has a process of its own, a
copy of this one, in which it takes the place of its module and its tests run, the quickest first,
until one fails. No file is changed; what tests start as new programs has no mutant in it. A test
that failed has to pass where its module is replaced by the same source, else it counts as passed.
Run: ``python benchmarks/mutation.py depthcli/core [MORE...] [--sample N] [--seed S] [--tests ...]``
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import copy
import gc
import importlib
import multiprocessing
import os
import random
import resource
import signal
import sys
import tempfile
import time
from collections import Counter, defaultdict
from functools import partial
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import coverage
import hypothesis
import pytest
from _pytest.runner import runtestprotocol

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from multiprocessing.connection import Connection

ROOT = Path(__file__).resolve().parents[1]
_FORK = multiprocessing.get_context("fork")
_LEAST_S, _TIMES = 60, 20  # a mutant that runs this much longer than its tests did is noticed
_CPU_S = 30
T = TypeVar("T")
_OTHER: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Pow: ast.Mult,
    ast.And: ast.Or,
    ast.Or: ast.And,
}

_NO_RESULT = {"strict", "out", "dst", "copy"}  # arguments that only check or save memory


class Mutant(NamedTuple):
    """A module with one fault.

    Attributes:
        line: where the fault is, from 1.
        function: the line where the outermost function around it begins; 0 where there is none.
        before: the code that was there.
        after: the code that is there now.
        source: the whole module.
    """

    line: int
    function: int
    before: str
    after: str
    source: str


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


class Functions:
    """All functions of some files, however they are wrapped or registered."""

    def __init__(self, files: set[str]) -> None:
        """Find them among all objects there are."""
        self._found = defaultdict(list)
        for thing in gc.get_objects():
            if type(thing) is FunctionType and thing.__code__.co_filename in files:
                self._found[_place(thing.__code__)].append(thing)

    def change(self, file: str, source: str) -> None:
        """Give them the code of changed source, those before and around the change at least."""
        codes = list(_codes(compile(source, file, "exec")))
        times = Counter(map(_place, codes))
        for code in codes:
            for function in self._found.get(_place(code), ()):
                # Of several lambdas in a line, which is which cannot be told.
                if times[_place(code)] == 1 and function.__code__.co_freevars == code.co_freevars:
                    function.__code__ = code


def _place(code: CodeType) -> tuple[str, str, int]:
    return code.co_filename, code.co_qualname, code.co_firstlineno


def _codes(code: CodeType) -> Iterator[CodeType]:
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield constant
            yield from _codes(constant)


def change_values(module: ModuleType, source: str) -> None:
    """Give a module, its classes and its functions' arguments the values of changed source.

    Not changed are the members of enumerations, and what other modules computed of the values when
    they were loaded.
    """
    new = ModuleType(module.__name__)
    for name in ("__file__", "__package__", "__spec__", "__loader__"):
        setattr(new, name, getattr(module, name))
    exec(compile(source, str(module.__file__), "exec"), vars(new))  # noqa: S102
    for name, after in list(vars(new).items()):
        before = getattr(module, name, None)
        if getattr(after, "__module__", None) not in (None, module.__name__):
            continue
        if isinstance(before, type) and isinstance(after, type):
            _change_class(before, after)
        elif isinstance(getattr(before, "__wrapped__", before), FunctionType):
            _change_defaults(before, after)
        elif not name.startswith("__") and not isinstance(after, ModuleType):
            _rebind(name, before, after)


def _change_class(old: type, new: type) -> None:
    for name, after in list(vars(new).items()):
        before = vars(old).get(name)
        if name == "__dataclass_fields__":
            for field, changed in after.items():
                if before[field].default != changed.default:
                    before[field].default = changed.default
        elif isinstance(before, (staticmethod, classmethod)):
            _change_defaults(before.__func__, after.__func__)
        elif isinstance(before, FunctionType):
            _change_defaults(before, after)
        elif isinstance(after, (bool, int, float, str, tuple)) and before != after:
            setattr(old, name, after)


def _change_defaults(old: FunctionType, new: FunctionType) -> None:
    while hasattr(old, "__wrapped__") and hasattr(new, "__wrapped__"):
        old, new = old.__wrapped__, new.__wrapped__
    if old.__defaults__ and new.__defaults__:
        pairs = zip(old.__defaults__, new.__defaults__, strict=False)
        old.__defaults__ = tuple(before if before == after else after for before, after in pairs)
    for name, after in (new.__kwdefaults__ or {}).items():
        if old.__kwdefaults__[name] != after:  # an equal member of an enumeration is not the same
            old.__kwdefaults__[name] = after


def _rebind(name: str, old: object, new: object) -> None:
    if type(new).__module__ == type(old).__module__ and type(new) is not type(old):
        object.__setattr__(new, "__class__", type(old))  # the class that everybody knows
    for module in list(sys.modules.values()):
        if isinstance(module, ModuleType) and vars(module).get(name) is old:
            setattr(module, name, new)


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


def sampled(folder: Path, count: int | None, seed: int) -> list[Place]:
    """Mutants of a module, or of a folder's modules: all, or a random sample."""
    path = folder.resolve().relative_to(ROOT)
    modules = sorted(path.rglob("*.py")) if path.is_dir() else [path]
    found = [Place(m, mutant) for m in modules for mutant in mutants((ROOT / m).read_text("utf-8"))]
    print(f"{path}: {len(found)} mutants")
    if count and count < len(found):
        found = random.Random(seed).sample(found, count)  # noqa: S311
    return sorted(found, key=lambda place: (place.module, place.mutant.line))


def main() -> None:
    """Run the trials and print how each mutant ended."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path, help="modules, or folders of them")
    parser.add_argument("--sample", type=int, help="how many mutants of each; all by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", help="of the sample, those at these FILE:LINE")
    parser.add_argument(
        "--tests",
        nargs=argparse.REMAINDER,
        help="in place of those of the folders; any words of pytest",
    )
    parser.add_argument(
        "--seconds",
        type=float,
        default=10,
        help="of processor time, of tests that are run with a mutant",
    )
    options = parser.parse_args()
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    of_folder = {f: sampled(f, options.sample, options.seed) for f in options.folders}
    if options.only:
        of_folder = {f: [p for p in of_folder[f] if p.at in options.only] for f in of_folder}
    own = sorted({f"tests/{places[0].module.parts[1]}" for places in of_folder.values()})
    trials = Trials([place for places in of_folder.values() for place in places], options.seconds)
    words = ["-q", "-s", "-p", "no:cacheprovider", "-o", "tmp_path_retention_policy=none"]
    hypothesis.settings.register_profile(
        "mutants", database=None, derandomize=True, deadline=None, phases=list(hypothesis.Phase)[:3]
    )
    with tempfile.TemporaryDirectory() as temporary:
        hypothesis.configuration.set_hypothesis_home_dir(temporary)
        words += ["--hypothesis-profile", "mutants", "--basetemp", temporary + "/tests"]
        pytest.main([*words, *(options.tests or own)], [trials])
    for folder, places in of_folder.items():
        ends = [trials.noticed_by[place] for place in places]
        count = sum(map(bool, ends))
        print(f"{folder}: {count} of {len(ends)} noticed ({count / len(ends):.0%})", end=", ")
        print(f"{ends.count('time')} by time")


if __name__ == "__main__":
    main()
