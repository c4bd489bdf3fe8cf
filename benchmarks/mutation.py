"""How many small faults the tests notice.

Figure of merit: the share of mutants (a comparison, an operator, a constant or a flag changed, a
statement or a keyword argument dropped) with which at least one test of the module fails. The
tests of a module are those that import it: of its package's folder in tests/, else of any, and
where none does, all of that folder. Mutants run in a copy of the tree; the survivors are printed,
each on a line.
Run: ``python benchmarks/mutation.py depthcli/core/*.py [--sample N] [--seed S] [--tests FILE ...]``
"""

from __future__ import annotations

import argparse
import importlib
import multiprocessing
import os
import random
import re
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, NoReturn

import pytest
from mutants import Mutant, mutants

if TYPE_CHECKING:
    from collections.abc import Sequence

ROOT = Path(__file__).resolve().parents[1]
COPIED = (
    *("depthcli", "docs", "models", "tests", "pyproject.toml"),
    *("README.md", "LICENSE", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "benchmarks"),
)
FORK = multiprocessing.get_context("fork")
LOADED_ONCE = ("cv2", "hypothesis", "numpy", "onnx", "onnxruntime")
_LEAST_S, _TIMES = 20, 6  # a mutant that runs this much longer than the module itself is noticed


class Trial(NamedTuple):
    """A mutant and what has to notice it."""

    module: Path
    mutant: Mutant
    tests: tuple[str, ...]


def tests_of(module: Path) -> tuple[str, ...]:
    """Test files of a module, relative to the tree."""
    names = module.with_suffix("").parts
    package, name = re.escape(".".join(names[:-1])), names[-1]
    imports = re.compile(
        rf"import {package}\.{name}\b|from {package}(\.{name}\b| import .*\b{name}\b)"
    )
    folder = ROOT / "tests" / names[1]
    own = _importing(imports, folder) or _importing(imports, ROOT / "tests")
    return tuple(str(file.relative_to(ROOT)) for file in own or folder.rglob("test_*.py"))


def _importing(imports: re.Pattern[str], folder: Path) -> list[Path]:
    files = sorted(folder.rglob("test_*.py"))
    return [file for file in files if imports.search(file.read_text("utf-8"))]


def passes(folder: Path, tests: Sequence[str], limit_s: float) -> bool:
    """Whether all tests pass in a copy of the tree, within some seconds."""
    process = FORK.Process(target=_test, args=(folder, tests))
    process.start()
    process.join(limit_s)
    if process.is_alive():
        process.kill()
        process.join()
    return process.exitcode == 0


def _test(folder: Path, tests: Sequence[str]) -> NoReturn:
    silence = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(silence, stream)
    os.chdir(folder)
    os.environ["PYTHONPATH"] = str(folder)
    sys.path.insert(0, str(folder))
    sys.dont_write_bytecode = True  # of two mutants within a second, the first would be run twice
    sys.exit(pytest.main(["-x", "-q", "-p", "no:cacheprovider", *tests]))


def survives(folder: Path, trial: Trial, limit_s: float) -> bool:
    """Whether the tests pass with the mutant in place of its module."""
    place = folder / trial.module
    whole = place.read_text("utf-8")
    place.write_text(trial.mutant.source, "utf-8")
    try:
        return passes(folder, trial.tests, limit_s)
    finally:
        place.write_text(whole, "utf-8")


def seconds(folder: Path, test: str) -> float:
    """How long a test file takes.

    Raises:
        SystemExit: it fails without any mutant.
    """
    start = time.monotonic()
    if not passes(folder, [test], 600):
        raise SystemExit(f"fails without a mutant: {test}")
    return time.monotonic() - start


def plan(options: argparse.Namespace) -> list[Trial]:
    """The trials, or a random sample of them, by module and line."""
    trials = []
    for path in options.modules:
        module = path.resolve().relative_to(ROOT)
        tests = tuple(options.tests or tests_of(module))
        found = mutants((ROOT / module).read_text("utf-8"))
        trials += [Trial(module, mutant, tests) for mutant in found]
    if options.sample and options.sample < len(trials):
        trials = random.Random(options.seed).sample(trials, options.sample)  # noqa: S311
    return sorted(trials, key=lambda trial: (trial.module, trial.mutant.line))


def main() -> None:
    """Run the trials and print the survivors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="+", type=Path)
    parser.add_argument("--sample", type=int, help="how many mutants; all by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tests", nargs="+", help="test files, in place of the modules' own")
    options = parser.parse_args()
    trials, survived = plan(options), 0
    for name in LOADED_ONCE:
        importlib.import_module(name)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name in COPIED:
            copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copyfile
            copy(ROOT / name, folder / name)
        names = {name for trial in trials for name in trial.tests}
        taken_s = {name: seconds(folder, name) for name in sorted(names)}
        for trial in trials:
            usual_s = sum(taken_s[name] for name in trial.tests)
            if survives(folder, trial, max(_LEAST_S, _TIMES * usual_s)):
                survived += 1
                line, before, after, _ = trial.mutant
                print(f"{trial.module}:{line}: {before}  ->  {after}", flush=True)
    killed = len(trials) - survived
    print(f"{killed} of {len(trials)} mutants were noticed ({killed / max(1, len(trials)):.0%})")


if __name__ == "__main__":
    main()
