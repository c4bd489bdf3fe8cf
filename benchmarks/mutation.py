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
import os
import random
import sys
import tempfile
from pathlib import Path

import hypothesis
import pytest
from mutants import mutants
from trials import ROOT, Place, Trials


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
