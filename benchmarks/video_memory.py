"""Whether a long video needs more memory than a short one.

The figure of merit is the peak resident memory of ``depthcli video`` on 5,000 frames divided by
that on 200 (at most 1.1), from whole processes that take turns, with the frames small so that it
takes minutes. Run: ``python benchmarks/video_memory.py [--rounds 2] [--format mkv ...]``
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from made_pictures import write_video
from memory import compare_peaks

WIDTH, HEIGHT = 160, 120
SHORT, LONG = 200, 5000


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--format", nargs="+", default=["mkv", "mp4"])
    options = parser.parse_args()
    formats = [word for name in options.format for word in ("--format", name)]
    with tempfile.TemporaryDirectory() as name:
        commands = {
            count: (
                "video",
                str(write_video(Path(name) / f"{count}.avi", count, WIDTH, HEIGHT)),
                *formats,
            )
            for count in (SHORT, LONG)
        }
        compare_peaks(commands, "frames", options.rounds)


if __name__ == "__main__":
    main()
