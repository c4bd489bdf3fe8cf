"""How fast a model is here: the network alone, whole pictures one by one, and many at a time."""

from __future__ import annotations

import statistics
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import cv2
import numpy as np

from depthcli.core.parallel.opencv_threads import one_thread_each
from depthcli.core.parallel.ordered_map import ordered_map
from depthcli.inference.preprocess import prepare
from depthcli.io.pictures.read import read_image
from depthcli.io.writers.png16 import Png16Writer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from depthcli.inference.pipeline import Pipeline

_UNMEASURED = 3
_FEWEST = 5
_MEBIBYTE = 2**20


@dataclass(frozen=True, slots=True)
class Latency:
    """Wall-clock milliseconds of one thing done several times.

    Attributes:
        median_ms: of the runs.
        min_ms: of the runs.
        noise: half the spread of the middle half of the runs, as a share of the median.
        runs: how many were measured, after a few that were not.
    """

    median_ms: float
    min_ms: float
    noise: float
    runs: int


@dataclass(frozen=True, slots=True)
class Speed:
    """What was measured.

    Attributes:
        network: one picture through the network alone.
        whole: one picture from an encoded file to a 16-bit PNG on the disk.
        pictures_per_s: of whole pictures, by several workers at a time.
        peak_memory_mb: most memory of this process so far, in MiB; None where the system does not
            tell.
    """

    network: Latency
    whole: Latency
    pictures_per_s: float
    peak_memory_mb: float | None


def measure_speed(
    alone: Pipeline, shared: Pipeline, picture: bytes, *, workers: int, seconds: float
) -> Speed:
    """Measure a model.

    Args:
        alone: the model with all the threads that one picture may take.
        shared: the same model with the threads of one worker.
        picture: a picture file's content.
        workers: pictures at the same time, for the throughput.
        seconds: how long each of the three measurements lasts, at least.

    Raises:
        InputError: the picture cannot be read.
        ModelError: the network fails.
    """
    frame = read_image(None, picture)
    batch, _ = prepare(alone.card.input, frame)
    with TemporaryDirectory(prefix="depthcli-") as name:
        folder = Path(name)
        network = _latency(lambda: alone.session.run(batch), seconds)
        whole = _latency(lambda: _convert(alone, picture, folder / "alone.png"), seconds)
        rate = _throughput(shared, picture, folder, workers, seconds)
    return Speed(network, whole, rate, peak_memory_mb())


def made_picture(width: int, height: int) -> bytes:
    """A JPEG of about the weight of a photograph: soft shapes under grain."""
    random = np.random.default_rng(0)
    coarse = random.uniform(30, 220, (6, 8, 3)).astype(np.float32)
    soft = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    grain = random.normal(0, 4, (height, width, 1)).astype(np.float32)
    pixels = np.clip(soft + grain, 0, 255).astype(np.uint8)
    return cv2.imencode(".jpg", pixels, (cv2.IMWRITE_JPEG_QUALITY, 90))[1].tobytes()


def peak_memory_mb() -> float | None:
    """Most resident memory of this process so far, in MiB; None where the system does not tell."""
    if sys.platform == "win32":
        return None
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / _MEBIBYTE


def _convert(pipeline: Pipeline, picture: bytes, path: Path) -> None:
    frame = read_image(None, picture)
    Png16Writer().write(pipeline.predict(frame), path, frame)


def _latency(action: Callable[[], object], seconds: float) -> Latency:
    for _ in range(_UNMEASURED):
        action()
    runs_ms: list[float] = []
    end_s = time.perf_counter() + seconds
    while len(runs_ms) < _FEWEST or time.perf_counter() < end_s:
        start_s = time.perf_counter()
        action()
        runs_ms.append(1e3 * (time.perf_counter() - start_s))
    low, median, high = statistics.quantiles(runs_ms, n=4)
    return Latency(median, min(runs_ms), (high - low) / 2 / median, len(runs_ms))


def _throughput(
    pipeline: Pipeline, picture: bytes, folder: Path, workers: int, seconds: float
) -> float:
    """Pictures a second, from the first one done to the last one begun in time."""

    def numbers() -> Iterator[int]:
        end_s = time.perf_counter() + seconds
        number = 0
        while number < 2 * workers + _FEWEST or time.perf_counter() < end_s:
            yield number
            number += 1

    def work(number: int) -> float:
        _convert(pipeline, picture, folder / f"{number % (2 * workers)}.png")
        return time.perf_counter()

    with one_thread_each(workers):
        ends_s = sorted(ordered_map(work, numbers(), workers=workers))
    return (len(ends_s) - 1) / (ends_s[-1] - ends_s[0])
