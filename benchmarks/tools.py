"""What the benchmarks share: options, timing in turns, cost of processes, images and videos."""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec, TypeVar

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from depthcli.models.catalog import Model

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")
_SETTLE_S = 0.05
"""Idle threads of the action before spin for a while."""
_UNIT = 1 if sys.platform == "darwin" else 1024  # of ru_maxrss
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed package need not be compiled again
ROOM = Path(__file__).parents[1] / "docs" / "room.jpg"
WIDTH, HEIGHT = 640, 480
_PLAIN = """
import os, sys, cv2, numpy as np, onnxruntime
folder, model, out, width, height = sys.argv[1:]
session = onnxruntime.InferenceSession(model)
name = session.get_inputs()[0].name
os.makedirs(out, exist_ok=True)
for file in sorted(os.listdir(folder)):
    image = cv2.imread(os.path.join(folder, file))
    value = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)[..., 2]
    gray = cv2.resize(value, (int(width), int(height)), interpolation=cv2.INTER_AREA)
    batch = (gray.astype(np.float32) / 127.5 - 1)[None, None]
    raw = session.run(None, {name: batch})[0][0, 0]
    depth = cv2.resize(np.exp(raw), image.shape[1::-1])
    cv2.imwrite(os.path.join(out, file + ".png"), (depth * 1000).astype(np.uint16))
"""
DEPTHCLI = (sys.executable, "-m", "depthcli")


def parse_options(
    description: str | None,
    *paths: str,
    rest: tuple[str, Sequence[Any]] | None = None,
    **defaults: Any,  # noqa: ANN401
) -> argparse.Namespace:
    """Parse the command line of a benchmark.

    Args:
        description: the module's docstring.
        paths: names of positional arguments.
        rest: name of further positional arguments, and what stands for them if there are none.
        defaults: options; a type stands for an option of this type without a default, a list for
            one of several values, False for a flag.
    """
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name in paths:
        parser.add_argument(name, type=Path)
    if rest is not None:
        name, values = rest
        parser.add_argument(name, nargs="*", type=type(values[0]), default=list(values))
    for name, default in defaults.items():
        option = f"--{name.replace('_', '-')}"
        if default is False:
            parser.add_argument(option, action="store_true")
        elif isinstance(default, type):
            parser.add_argument(option, type=default)
        elif isinstance(default, list):
            item = type(default[0]) if default else str
            parser.add_argument(option, type=item, nargs="+", default=default)
        else:
            parser.add_argument(option, type=type(default), default=default)
    return parser.parse_args()


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


def alternate(actions: Sequence[Callable[[], object]], runs: int, *, per: int = 1) -> list[Timing]:
    """Time actions in turn, A B A B …, so that a drifting machine drifts for all of them.

    Each runs twice unmeasured first. Seconds are those of an action, divided by ``per``.
    """
    seconds: list[list[float]] = [[] for _ in actions]
    for run in range(runs + 2):
        for action, measured in zip(actions, seconds, strict=True):
            time.sleep(_SETTLE_S)
            elapsed_s = wall_s(action)
            if run > 1:
                measured.append(elapsed_s / per)
    return [Timing(tuple(measured)) for measured in seconds]


def wall_s(action: Callable[[], object]) -> float:
    """Seconds that an action takes."""
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def process(*arguments: str) -> Callable[[], object]:
    """A whole Python process as an action."""
    command = [sys.executable, *arguments]
    return lambda: subprocess.run(command, check=True, capture_output=True)


def plain_script(model: Model, source: str, out: str) -> Callable[[], object]:
    """What anyone would write to estimate the depth of the JPEGs of a folder, as an action."""
    spec = model.card.input
    return process("-c", _PLAIN, source, str(model.path), out, str(spec.width), str(spec.height))


class Stages:
    """CPU seconds of the stages of one kind of work."""

    def __init__(self) -> None:
        self._seconds: dict[str, list[float]] = defaultdict(list)

    def __call__(
        self,
        name: str,
        action: Callable[_Arguments, _Result],
        *arguments: _Arguments.args,
        **named: _Arguments.kwargs,
    ) -> _Result:
        """Measure a stage once, with the threads that it starts."""
        start = time.process_time()
        result = action(*arguments, **named)
        self._seconds[name].append(time.process_time() - start)
        return result

    def each_s(self, count: int | None = None) -> dict[str, float]:
        """Seconds of each stage: the median of its calls, or their sum divided by ``count``."""
        return {
            name: sum(seconds) / count if count else statistics.median(seconds)
            for name, seconds in self._seconds.items()
        }


def print_stages(stages_s: dict[str, float]) -> None:
    """Print a line for each stage."""
    for name, seconds in stages_s.items():
        print(f"  {name:<20} {seconds * 1e3:6.2f} ms CPU")


def print_spread(name: str, values: Sequence[float], unit: str = "") -> None:
    """Print the median of some measurements, and the least and the largest."""
    print(
        f"{name:<44} {statistics.median(values):8.3f} {unit}  "
        f"({min(values):.3f} to {max(values):.3f})"
    )


def ratios(values: Sequence[float], to: Sequence[float]) -> list[float]:
    """Measurements divided by those of the same round."""
    return [value / base for value, base in zip(values, to, strict=True)]


def print_cost(what: str, action: Callable[[], object], count: int = 1) -> None:
    """Print the time of some work on ``count`` things, and the peak memory of this process."""
    cpu_s = time.process_time()
    elapsed_s = wall_s(action)
    cpu_s = time.process_time() - cpu_s
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _UNIT / 1e6
    print(
        f"{what:<24} {count:>11,} in {elapsed_s:6.1f} s, {1e3 * cpu_s / count:8.3f} ms CPU, "
        f"{1e3 * elapsed_s / count:8.3f} ms wall each; peak {peak_mb:6.0f} MB",
        flush=True,
    )


class Usage(NamedTuple):
    """What a process used."""

    cpu_s: float
    peak_bytes: int


def usage(command: Sequence[str], **options: Any) -> Usage:  # noqa: ANN401 - as of Popen
    """Run a process to its end."""
    running = subprocess.Popen(command, **options)
    _, status, used = os.wait4(running.pid, 0)
    running.returncode = os.waitstatus_to_exitcode(status)
    if running.returncode:
        raise subprocess.CalledProcessError(running.returncode, command)
    return Usage(used.ru_utime + used.ru_stime, used.ru_maxrss * _UNIT)


def peak_bytes(words: Sequence[str], out: Path) -> int:
    """Peak resident memory of ``depthcli WORDS --out OUT``, whose outputs are removed."""
    used = usage((*DEPTHCLI, *words, "--out", str(out), "--quiet"))
    shutil.rmtree(out)
    return used.peak_bytes


def write_images(folder: Path, count: int) -> list[Path]:
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
