"""Whether a long video needs more memory than a short one.

The figure of merit is the peak resident memory of ``depthcli video`` on 5,000 frames divided by
that on 200 (at most 1.1), from whole processes that take turns, with the frames small so that it
takes minutes. Run: ``python benchmarks/video_memory.py [--rounds 2] [--format mkv ...]``
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
from typing import TYPE_CHECKING

from made_pictures import write_video

if TYPE_CHECKING:
    from collections.abc import Sequence

WIDTH, HEIGHT = 160, 120
SHORT, LONG = 200, 5000
_UNIT = 1 if sys.platform == "darwin" else 1024  # of ru_maxrss


def peak_bytes(video: Path, out: Path, formats: Sequence[str]) -> int:
    """Peak resident memory of one run."""
    words = [word for name in formats for word in ("--format", name)]
    command = ("depthcli", "video", str(video), "--out", str(out), "--quiet", *words)
    running = subprocess.Popen([sys.executable, "-m", *command])
    _, status, usage = os.wait4(running.pid, 0)
    running.returncode = os.waitstatus_to_exitcode(status)
    if running.returncode:
        raise subprocess.CalledProcessError(running.returncode, command)
    shutil.rmtree(out)
    return usage.ru_maxrss * _UNIT


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--format", nargs="+", default=["mkv", "mp4"])
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        videos = {n: write_video(folder / f"{n}.avi", n, WIDTH, HEIGHT) for n in (SHORT, LONG)}
        peaks: dict[int, list[int]] = {SHORT: [], LONG: []}
        for _ in range(options.rounds):
            for count, video in videos.items():
                start = time.perf_counter()
                peaks[count].append(peak_bytes(video, folder / "out", options.format))
                rate = count / (time.perf_counter() - start)
                print(f"{count:5} frames: {peaks[count][-1] / 1e6:6.1f} MB  {rate:.0f} frames/s")
    short, long = (statistics.median(peaks[count]) for count in (SHORT, LONG))
    noise = max(max(p) / min(p) - 1 for p in peaks.values())
    print(f"ratio {long / short:.3f}  (runs of one length differ by {noise:.1%})")


if __name__ == "__main__":
    main()
