"""Peak memory of whole processes, and whether it grows with the work."""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_UNIT = 1 if sys.platform == "darwin" else 1024  # of ru_maxrss


def peak_bytes(words: Sequence[str], out: Path) -> int:
    """Peak resident memory of ``depthcli WORDS --out OUT``, whose outputs are removed."""
    command = (sys.executable, "-m", "depthcli", *words, "--out", str(out), "--quiet")
    running = subprocess.Popen(command)
    _, status, usage = os.wait4(running.pid, 0)
    running.returncode = os.waitstatus_to_exitcode(status)
    if running.returncode:
        raise subprocess.CalledProcessError(running.returncode, command)
    shutil.rmtree(out)
    return usage.ru_maxrss * _UNIT


def compare_peaks(commands: Mapping[int, Sequence[str]], what: str, rounds: int) -> None:
    """Let two commands take turns, and print the peak of each run and their ratio.

    Args:
        commands: words of the command by how much it has to do, the smaller one first.
        what: there is to do: "frames".
        rounds: how often each one runs.
    """
    peaks: dict[int, list[int]] = {count: [] for count in commands}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(rounds):
            for count, words in commands.items():
                start = time.perf_counter()
                peaks[count].append(peak_bytes(words, Path(folder) / "out"))
                rate = count / (time.perf_counter() - start)
                print(f"{count:5} {what}: {peaks[count][-1] / 1e6:6.1f} MB  {rate:.0f}/s")
    few, many = (statistics.median(found) for found in peaks.values())
    noise = max(max(found) / min(found) - 1 for found in peaks.values())
    print(f"ratio {many / few:.3f}  (runs on as many {what} differ by {noise:.1%})")
