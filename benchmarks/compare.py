"""What another version of depthcli costs beside this one: CPU time and memory of whole processes.

Each command runs in turns with the two source trees, so that a drifting machine drifts for both,
and with the other's model; the ratios are those of runs beside each other, the other tree's over
this one's. CPU time is user and system together, of all threads. Modules come from bytecode, as
where depthcli is installed: without it each start would compile the source anew.
Run: ``python benchmarks/compare.py OTHER_TREE [--rounds 7]``
"""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import tempfile
from pathlib import Path

from tools import DEPTHCLI, Usage, parse_options, usage, write_images, write_video

HERE = Path(__file__).parents[1]
FRAMES = 60


def cost(tree: Path, words: list[str], out: Path) -> Usage:
    """Of a command of one tree; what it writes is removed."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(tree),
        "PYTHONDONTWRITEBYTECODE": "",
        "PYTHONPYCACHEPREFIX": str(out.parent / "bytecode"),
    }
    # Python looks for modules where it is started before it looks where PYTHONPATH says.
    used = usage((*DEPTHCLI, *words), env=environment, cwd=out.parent, stdout=subprocess.DEVNULL)
    shutil.rmtree(out, ignore_errors=True)
    return used


def main() -> None:
    """Measure and print."""
    options = parse_options(__doc__, "other", rounds=7)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        image = write_images(folder / "in", FRAMES)[0]
        video = write_video(folder / "room.avi", FRAMES)
        out = folder / "out"
        model = str(options.other.resolve() / "models" / "default")
        common = ["--out", f"{out}/", "--quiet", "--model", model]
        commands = {
            "--help": ["--help"],
            "predict": ["predict", str(image), "-o", *common[1:]],
            f"batch of {FRAMES}": ["batch", str(folder / "in"), *common],
            f"{FRAMES} frames, mkv": ["video", str(video), "--format", "mkv", *common],
            f"{FRAMES} frames, mkv and mp4": ["video", str(video), *common],
        }
        for label, words in commands.items():
            runs = [
                [cost(tree, words, out) for tree in (options.other.resolve(), HERE)]
                for _ in range(options.rounds + 1)
            ][1:]
            then, now = (statistics.median(run[i].cpu_s for run in runs) for i in (0, 1))
            cpu = sorted(run[0].cpu_s / run[1].cpu_s for run in runs)
            memory = statistics.median(run[0].peak_bytes / run[1].peak_bytes for run in runs)
            print(
                f"{label:<24} {then * 1e3:6.0f} -> {now * 1e3:6.0f} ms CPU, ratio "
                f"{statistics.median(cpu):.3f} ({cpu[0]:.3f} to {cpu[-1]:.3f}), "
                f"memory {memory:.3f}"
            )


if __name__ == "__main__":
    main()
