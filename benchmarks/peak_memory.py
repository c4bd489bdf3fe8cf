"""Whether a large folder or a long video needs more memory than a small one.

The figure of merit is the peak resident memory of ``depthcli batch`` on 5,000 images of 640×480, or
with ``--format`` of ``depthcli video`` on 5,000 small frames, divided by that on 200 (at most 1.1),
from whole processes that take turns. The 5,000 images are hard links to the 200; every one is read,
and gets an output of its own.
Run: ``python benchmarks/peak_memory.py [--rounds 2] [--format mkv ...] [--many 5000]``
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path

from tools import parse_options, peak_bytes, write_images, write_video

FEW = 200
VIDEO_PX = 160, 120


def folders(folder: Path, many: int) -> dict[int, tuple[str, ...]]:
    """Commands for a few images, and for many names of them."""
    images = write_images(folder / "few", FEW)
    (folder / "many").mkdir()
    for number in range(many):
        (folder / "many" / f"{number:05}.jpg").hardlink_to(images[number % len(images)])
    return {FEW: ("batch", str(folder / "few")), many: ("batch", str(folder / "many"))}


def videos(folder: Path, many: int, formats: list[str]) -> dict[int, tuple[str, ...]]:
    """Commands for a short and a long video."""
    words = [word for name in formats for word in ("--format", name)]
    files = {count: write_video(folder / f"{count}.avi", count, *VIDEO_PX) for count in (FEW, many)}
    return {count: ("video", str(file), *words) for count, file in files.items()}


def main() -> None:
    """Let two commands take turns, and print the peak of each run and their ratio."""
    options = parse_options(__doc__, rounds=2, format=[], many=5000)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        commands = (
            videos(folder, options.many, options.format)
            if options.format
            else folders(folder, options.many)
        )
        what = "frames" if options.format else "images"
        peaks: dict[int, list[int]] = {count: [] for count in commands}
        for _ in range(options.rounds):
            for count, words in commands.items():
                start = time.perf_counter()
                peaks[count].append(peak_bytes(words, folder / "out"))
                rate = count / (time.perf_counter() - start)
                print(f"{count:5} {what}: {peaks[count][-1] / 1e6:6.1f} MB  {rate:.0f}/s")
    few, many = map(statistics.median, peaks.values())
    noise = max(max(runs) / min(runs) - 1 for runs in peaks.values())
    print(f"ratio {many / few:.3f}  (runs on as many {what} differ by {noise:.1%})")


if __name__ == "__main__":
    main()
