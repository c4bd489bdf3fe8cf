"""What another version of depthcli costs beside this one: CPU time and memory of whole processes.

Each command runs in turns with the two source trees and one model, so that a drifting machine
drifts for both; the ratios are those of runs beside each other, the other tree's over this one's.
CPU time is user and system together, of all threads. Modules come from bytecode, as where
depthcli is installed: without it each start would compile the source anew.
Run: ``python benchmarks/compare.py OTHER_TREE [--rounds 7]``
"""

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from tools import write_pictures, write_video

HERE = Path(__file__).parents[1]
FRAMES = 60


def cost(tree: Path, words: list[str], out: Path) -> tuple[float, float]:
    """CPU milliseconds and peak MB of a command of one tree; what it writes is removed."""
    command = [sys.executable, "-m", "depthcli", *words]
    environment = {
        **os.environ,
        "PYTHONPATH": str(tree),
        "PYTHONDONTWRITEBYTECODE": "",
        "PYTHONPYCACHEPREFIX": str(out.parent / "bytecode"),
    }
    # Python looks for modules where it is started before it looks where PYTHONPATH says.
    running = subprocess.Popen(command, env=environment, cwd=out.parent, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(running.pid, 0)
    running.returncode = os.waitstatus_to_exitcode(status)
    if running.returncode:
        raise subprocess.CalledProcessError(running.returncode, command)
    shutil.rmtree(out, ignore_errors=True)
    return (usage.ru_utime + usage.ru_stime) * 1e3, usage.ru_maxrss / 1e3


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("other", type=Path)
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        picture = write_pictures(folder / "in", FRAMES)[0]
        video = write_video(folder / "room.avi", FRAMES)
        out = folder / "out"
        common = ["--out", f"{out}/", "--quiet", "--model", str(HERE / "models" / "default")]
        commands = {
            "--help": ["--help"],
            "predict": ["predict", str(picture), "-o", *common[1:]],
            f"batch of {FRAMES}": ["batch", str(folder / "in"), *common],
            f"{FRAMES} frames, mkv": ["video", str(video), "--format", "mkv", *common],
            f"{FRAMES} frames, mkv and mp4": ["video", str(video), *common],
        }
        for label, words in commands.items():
            runs = [
                [cost(tree, words, out) for tree in (options.other.resolve(), HERE)]
                for _ in range(options.rounds + 1)
            ][1:]
            then, now = (statistics.median(run[i][0] for run in runs) for i in (0, 1))
            cpu = sorted(run[0][0] / run[1][0] for run in runs)
            memory = statistics.median(run[0][1] / run[1][1] for run in runs)
            print(
                f"{label:<24} {then:6.0f} -> {now:6.0f} ms CPU, ratio {statistics.median(cpu):.3f} "
                f"({cpu[0]:.3f} to {cpu[-1]:.3f}), memory {memory:.3f}"
            )


if __name__ == "__main__":
    main()
