"""Tools of the benchmarks: timing in turns, peak memory, and images and videos to work on."""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

_SETTLE_S = 0.05
"""Idle threads of the action before spin for a while."""
_UNIT = 1 if sys.platform == "darwin" else 1024  # of ru_maxrss
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed package need not be compiled again
ROOM = Path(__file__).parents[1] / "docs" / "room.jpg"
WIDTH, HEIGHT = 640, 480


class Timing(NamedTuple):
    """Seconds of several runs of one thing."""

    seconds: tuple[float, ...]

    @property
    def median_s(self) -> float:
        """The middle run."""
        return statistics.median(self.seconds)

    @property
    def noise(self) -> float:
        """Half the spread of the middle half of the runs, as a share of the median."""
        low, _, high = statistics.quantiles(self.seconds, n=4)
        return (high - low) / 2 / self.median_s

    def __str__(self) -> str:
        return (
            f"{self.median_s * 1e3:8.1f} ms  (min {min(self.seconds) * 1e3:.1f}, ±{self.noise:.0%})"
        )


def alternate(actions: Sequence[Callable[[], object]], runs: int) -> list[Timing]:
    """Time actions in turn, A B A B …, so that a drifting machine drifts for all of them.

    Each runs twice unmeasured first.
    """
    seconds: list[list[float]] = [[] for _ in actions]
    for run in range(runs + 2):
        for action, measured in zip(actions, seconds, strict=True):
            time.sleep(_SETTLE_S)
            start = time.perf_counter()
            action()
            if run > 1:
                measured.append(time.perf_counter() - start)
    return [Timing(tuple(measured)) for measured in seconds]


def process(*arguments: str) -> Callable[[], object]:
    """A whole Python process as an action."""
    command = [sys.executable, *arguments]
    return lambda: subprocess.run(command, check=True, capture_output=True)


def peak_bytes(words: Sequence[str], out: Path) -> int:
    """Peak resident memory of ``depthcli WORDS --out OUT``, whose outputs are removed."""
    command = (sys.executable, "-m", "depthcli", *words, "--out", str(out), "--quiet")
    peak = peak_of(command)
    shutil.rmtree(out)
    return peak


def peak_of(command: Sequence[str]) -> int:
    """Peak resident memory of a process."""
    running = subprocess.Popen(command)
    _, status, usage = os.wait4(running.pid, 0)
    running.returncode = os.waitstatus_to_exitcode(status)
    if running.returncode:
        raise subprocess.CalledProcessError(running.returncode, command)
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


def write_pictures(folder: Path, count: int) -> list[Path]:
    """Write different JPEG files of 60-100 KB: the room from other places, in other light."""
    room = cv2.imread(str(ROOM))
    random = np.random.default_rng(0)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number in range(count):
        path = folder / f"{number:05}.jpg"
        quality = (cv2.IMWRITE_JPEG_QUALITY, 90)
        cv2.imwrite(str(path), _view(room, random), quality)
        paths.append(path)
    return paths


def write_video(path: Path, count: int, width: int = WIDTH, height: int = HEIGHT) -> Path:
    """Write a video at 30000/1001, Motion JPEG: the room, under grain, passing by and back."""
    room = cv2.resize(cv2.imread(str(ROOM)), (width * 5 // 4, height * 5 // 4))
    random = np.random.default_rng(0)
    code = cv2.VideoWriter.fourcc(*"MJPG")
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, 30000 / 1001, (width, height))
    grains = random.normal(0, 3, (8, height, width, 1))
    path_px = [*range(width // 4), *range(width // 4, 0, -1)]
    for number in range(count):
        left, top = path_px[number % len(path_px)], height // 8
        view = room[top : top + height, left : left + width] + grains[number % len(grains)]
        writer.write(np.clip(view, 0, 255).astype(np.uint8))
    writer.release()
    return path


def _view(room: cv2.typing.MatLike, random: np.random.Generator) -> cv2.typing.MatLike:
    scale = random.uniform(1.0, 1.4)
    angle_deg = random.uniform(-5, 5)
    turn = cv2.getRotationMatrix2D((WIDTH / 2, HEIGHT / 2), angle_deg, scale)
    turn[:, 2] += random.uniform(-40, 40, 2)
    view = cv2.warpAffine(room, turn, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)
    if random.random() < 0.5:
        view = cv2.flip(view, 1)
    grain = random.normal(0, random.uniform(2, 5), (HEIGHT, WIDTH, 1))
    return np.clip(view * random.uniform(0.6, 1.2) + grain, 0, 255).astype(np.uint8)
