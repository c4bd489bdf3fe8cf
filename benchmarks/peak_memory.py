"""Whether a large folder needs more memory than a small one.

The figure of merit is the peak resident memory of ``depthcli batch`` on 5,000 pictures of 640×480
divided by that on 200 (at most 1.1), from whole processes that take turns. The 5,000 are hard links
to the 200; every one is read, and gets an output of its own.
Run: ``python benchmarks/peak_memory.py [--rounds 2]``
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from made_pictures import write_pictures

FEW, MANY = 200, 5000
_UNIT = 1 if sys.platform == "darwin" else 1024  # of ru_maxrss


def peak_bytes(pictures: Path, out: Path) -> int:
    """Peak resident memory of one run."""
    command = ("depthcli", "batch", str(pictures), "--out", str(out), "--quiet")
    running = subprocess.Popen([sys.executable, "-m", *command])
    _, status, usage = os.wait4(running.pid, 0)
    running.returncode = os.waitstatus_to_exitcode(status)
    if running.returncode:
        raise subprocess.CalledProcessError(running.returncode, command)
    shutil.rmtree(out)
    return usage.ru_maxrss * _UNIT


def link(pictures: list[Path], folder: Path) -> Path:
    """A folder of many names for a few pictures."""
    folder.mkdir()
    for number in range(MANY):
        (folder / f"{number:05}.jpg").hardlink_to(pictures[number % len(pictures)])
    return folder


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=2)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pictures = write_pictures(folder / "few", FEW)
        folders = {FEW: folder / "few", MANY: link(pictures, folder / "many")}
        peaks: dict[int, list[int]] = {FEW: [], MANY: []}
        for _ in range(options.rounds):
            for count, source in folders.items():
                start = time.perf_counter()
                peaks[count].append(peak_bytes(source, folder / "out"))
                rate = count / (time.perf_counter() - start)
                print(f"{count:5} pictures: {peaks[count][-1] / 1e6:6.1f} MB  {rate:.1f}/s")
    few, many = (statistics.median(peaks[count]) for count in (FEW, MANY))
    noise = max(max(p) / min(p) - 1 for p in peaks.values())
    print(f"ratio {many / few:.3f}  (runs on as many pictures differ by {noise:.1%})")


if __name__ == "__main__":
    main()
