"""Whether a large folder or a long video needs more memory than a small one.

The figure of merit is the peak resident memory of ``depthcli batch`` on 5,000 images of 640×480, or
with ``--format`` of ``depthcli video`` on 5,000 small frames, divided by that on 200 (at most 1.1),
from whole processes that take turns. The 5,000 images are hard links to the 200; every one is read,
and gets an output of its own.
Run: ``python benchmarks/peak_memory.py [--rounds 2] [--format mkv ...]``
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from tools import compare_peaks, write_pictures, write_video

FEW, MANY = 200, 5000
VIDEO_PX = 160, 120


def folders(folder: Path) -> dict[int, tuple[str, ...]]:
    """Commands for a few images, and for many names of them."""
    few, many = folder / "few", folder / "many"
    images = write_pictures(few, FEW)
    many.mkdir()
    for number in range(MANY):
        (many / f"{number:05}.jpg").hardlink_to(images[number % len(images)])
    return {FEW: ("batch", str(few)), MANY: ("batch", str(many))}


def videos(folder: Path, formats: list[str]) -> dict[int, tuple[str, ...]]:
    """Commands for a short and a long video."""
    words = [word for name in formats for word in ("--format", name)]
    files = {count: write_video(folder / f"{count}.avi", count, *VIDEO_PX) for count in (FEW, MANY)}
    return {count: ("video", str(file), *words) for count, file in files.items()}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--format", nargs="+")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        if options.format:
            compare_peaks(videos(Path(name), options.format), "frames", options.rounds)
        else:
            compare_peaks(folders(Path(name)), "images", options.rounds)


if __name__ == "__main__":
    main()
