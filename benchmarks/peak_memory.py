"""Whether a large folder needs more memory than a small one.

The figure of merit is the peak resident memory of ``depthcli batch`` on 5,000 pictures of 640×480
divided by that on 200 (at most 1.1), from whole processes that take turns. The 5,000 are hard links
to the 200; every one is read, and gets an output of its own.
Run: ``python benchmarks/peak_memory.py [--rounds 2]``
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from made_pictures import write_pictures
from memory import compare_peaks

FEW, MANY = 200, 5000


def link(pictures: list[Path], folder: Path) -> None:
    """A folder of many names for a few pictures."""
    folder.mkdir()
    for number in range(MANY):
        (folder / f"{number:05}.jpg").hardlink_to(pictures[number % len(pictures)])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=2)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        few, many = Path(name) / "few", Path(name) / "many"
        link(write_pictures(few, FEW), many)
        commands = {FEW: ("batch", str(few)), MANY: ("batch", str(many))}
        compare_peaks(commands, "pictures", options.rounds)


if __name__ == "__main__":
    main()
