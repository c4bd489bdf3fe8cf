"""Latency of actions that take turns, and a model's: network, end to end, and throughput."""

import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count, takewhile
from pathlib import Path

import cv2
import numpy as np

from depthcli.core.options import Upsampling, UpsamplingOptions
from depthcli.core.parallel import one_thread_each, ordered_map, share_cores
from depthcli.inference.loading import SessionLoader
from depthcli.inference.pipeline import Pipeline, depth_for_trial
from depthcli.inference.transforms import prepare
from depthcli.io.formats.raster import Png16Writer
from depthcli.io.images.read import read_image
from depthcli.io.storage.atomic import temporary_folder
from depthcli.io.storage.paths import read_bytes

_ROUNDS = 3
_MIN_RUNS = 5
_MIN_IMAGES = 5


@dataclass(frozen=True, slots=True)
class Latency:
    """Wall-clock milliseconds of an action that was repeated."""

    median_ms: float  #: of the runs
    min_ms: float  #: of the runs
    noise: float  #: half the interquartile range of the runs, as a share of the median
    runs: int  #: how many were measured, after warm-up


def measure_latencies(actions: Sequence[Callable[[], object]], seconds: float) -> list[Latency]:
    """Repeat each action for a number of seconds, and at least five times.

    They take turns, so that other load affects all alike. The first run of a turn does not count,
    as threads of the previous action may still be spinning.
    """
    times_ms: list[list[float]] = [[] for _ in actions]
    for turn in range(1, _ROUNDS + 1):
        for runs_ms, action in zip(times_ms, actions, strict=True):
            action()
            end_s = time.perf_counter() + seconds / _ROUNDS
            while len(runs_ms) < turn * _MIN_RUNS / _ROUNDS or time.perf_counter() < end_s:
                runs_ms.append(1e3 * _elapsed_s(action))
    latencies = []
    for runs_ms in times_ms:
        low, median, high = statistics.quantiles(runs_ms, n=4)
        latencies.append(Latency(median, min(runs_ms), (high - low) / 2 / median, len(runs_ms)))
    return latencies


def _elapsed_s(action: Callable[[], object]) -> float:
    started_s = time.perf_counter()
    action()
    return time.perf_counter() - started_s


def network_run(pipeline: Pipeline) -> Callable[[], object]:
    """An action that runs the network alone, for one image of its own size."""
    spec = pipeline.card.input
    shape = (1, spec.colour.channels, spec.height, spec.width)
    batch = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    return lambda: pipeline.session.run(batch)


@dataclass(frozen=True, slots=True)
class BenchResult:
    """The measurements of a model."""

    model: str  #: name in its card
    model_sha256: str  #: checksum of its file
    provider: str  #: the provider in use
    workers: int  #: images processed in parallel, for the throughput
    threads: int  #: of each of these workers, within one run of the network
    network: Latency  #: of the network alone, for one image
    end_to_end: Latency  #: from an encoded file to a 16-bit PNG on disk, for one image
    images_per_s: float  #: end-to-end throughput with several workers
    peak_memory_mb: float | None  #: of this process so far; None if the system does not report it


def run_bench(
    model: SessionLoader,
    synthetic_px: tuple[int, int],
    seconds: float,
    path: Path | None = None,
    upsampling: Upsampling = Upsampling.GUIDED,
    workers: int | None = None,
    warn: Callable[[str], object] = lambda _text: None,
) -> BenchResult:
    """Measure a model for some seconds each, on a file or a synthetic image of (width, height) px.

    ``workers`` images are processed in parallel for the throughput, by default one per core.
    """
    image = synthetic_image(*synthetic_px) if path is None else read_bytes(path)
    frame = read_image(path, image, name="the image")  # an error names the file
    workers, threads = share_cores(workers, model.threads)
    loaders = model, replace(model, threads=threads)
    alone, shared = (Pipeline(loader.load(), UpsamplingOptions(upsampling)) for loader in loaders)
    session, card = alone.session, alone.card
    for warning in session.warnings:
        warn(warning)
    batch, _ = prepare(card.input, frame)
    with temporary_folder() as folder:
        whole = partial(_predict_and_write, alone, image, folder / "alone.png")
        (network,) = measure_latencies([partial(session.run, batch)], seconds)
        (end_to_end,) = measure_latencies([whole], seconds)
        rate = throughput(shared, image, folder, workers, seconds)
    facts = (card.name, session.model.sha256, session.provider, workers, threads)
    return BenchResult(*facts, network, end_to_end, rate, peak_memory_mb())


def synthetic_image(width: int, height: int) -> bytes:
    """A JPEG of about the file size of a photograph: smooth shapes with grain."""
    random = np.random.default_rng(0)
    coarse = random.uniform(30, 220, (6, 8, 3)).astype(np.float32)
    soft = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    grain = random.normal(0, 4, (height, width, 1)).astype(np.float32)
    pixels = np.clip(soft + grain, 0, 255).astype(np.uint8)
    return cv2.imencode(".jpg", pixels, (cv2.IMWRITE_JPEG_QUALITY, 90))[1].tobytes()


def peak_memory_mb() -> float | None:
    """Peak resident memory of this process, in MB; None if the system does not report it."""
    if sys.platform == "win32":
        return None
    import resource  # noqa: PLC0415 - Windows has none

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def _predict_and_write(pipeline: Pipeline, image: bytes, path: Path) -> None:
    frame = read_image(None, image)
    Png16Writer().write(depth_for_trial(pipeline, frame), path, frame)


def throughput(
    pipeline: Pipeline, image: bytes, folder: Path, workers: int, seconds: float
) -> float:
    """Images per second, from the end of the first one to that of the last."""
    end_s, least = time.perf_counter() + seconds, 2 * workers + _MIN_IMAGES

    def work(number: int) -> float:
        _predict_and_write(pipeline, image, folder / f"{number % (2 * workers)}.png")
        return time.perf_counter()

    numbers = takewhile(lambda number: number < least or time.perf_counter() < end_s, count())
    with one_thread_each(workers):
        ends_s = sorted(ordered_map(work, numbers, workers=workers))
    return (len(ends_s) - 1) / (ends_s[-1] - ends_s[0])
