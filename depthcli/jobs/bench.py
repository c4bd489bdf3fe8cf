"""How fast a model is here: the network alone, end to end, and many pictures at a time."""

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from depthcli.core.choices import Detail, Upsampling
from depthcli.core.parallel.cores import share_cores
from depthcli.core.parallel.opencv_threads import one_thread_each
from depthcli.core.parallel.ordered_map import ordered_map
from depthcli.inference.latency import Latency, measure_latency
from depthcli.inference.loading import SessionLoader
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.preprocess import prepare
from depthcli.io.pictures.decode import read_bytes
from depthcli.io.pictures.read import read_image
from depthcli.io.storage.temporary_folder import temporary_folder
from depthcli.io.writers.png16 import Png16Writer

_FEWEST = 5
_MEGABYTE = 1e6


@dataclass(frozen=True, slots=True)
class BenchRequest:
    """What is measured."""

    model: SessionLoader  #: what runs, with the threads that one picture may take
    made_px: tuple[int, int]  #: (width, height) of the picture that is made
    seconds: float  #: how long each of three measurements lasts, at least
    picture: Path | None = None  #: a file in place of the made one
    upsampling: Upsampling = Upsampling.GUIDED  #: how depth gets to the picture's size
    #: pictures at the same time, for the throughput; None for one a core
    workers: int | None = None


@dataclass(frozen=True, slots=True)
class Speed:
    """What was measured."""

    network: Latency  #: one picture through the network alone
    end_to_end: Latency  #: one picture from an encoded file to a 16-bit PNG on the disk
    pictures_per_s: float  #: end to end, by several workers at a time
    #: most memory of this process so far, in MB; None where the system does not tell
    peak_memory_mb: float | None


@dataclass(frozen=True, slots=True)
class BenchResult:
    """What was measured, and of what."""

    model: str  #: name in its card
    model_sha256: str  #: checksum of its file
    provider: str  #: what really runs it
    workers: int  #: pictures at the same time, for the throughput
    speed: Speed  #: the figures


def run_bench(
    request: BenchRequest, warn: Callable[[str], object] = lambda _text: None
) -> BenchResult:
    """Measure a model on this machine; ``warn`` is told in one line what is not as it should be.

    Raises:
        InputError: the picture cannot be read.
        ModelError: the model is not there, cannot be used, or fails.
        UsageError: the provider or its options are none.
    """
    given = request.picture
    picture = made_picture(*request.made_px) if given is None else read_bytes(given)
    read_image(given, picture)  # an error names the file
    workers, threads = share_cores(request.workers)
    each = replace(request.model, threads=threads)
    detail = Detail(request.upsampling)
    alone, shared = (Pipeline(loader.load(), detail) for loader in (request.model, each))
    for warning in alone.session.warnings:
        warn(warning)
    speed = measure_speed(alone, shared, picture, workers=workers, seconds=request.seconds)
    session = alone.session
    return BenchResult(alone.card.name, session.model.sha256, session.provider, workers, speed)


def measure_speed(
    alone: Pipeline, shared: Pipeline, picture: bytes, *, workers: int, seconds: float
) -> Speed:
    """Measure a model on a picture file's content; each of three measurements lasts ``seconds``.

    ``alone`` has all the threads that one picture may take, ``shared`` those of one worker.

    Raises:
        InputError: the picture cannot be read.
        ModelError: the network fails.
    """
    frame = read_image(None, picture)
    batch, _ = prepare(alone.card.input, frame)
    with temporary_folder() as folder:
        network = measure_latency(lambda: alone.session.run(batch), seconds)
        end_to_end = measure_latency(
            lambda: _convert(alone, picture, folder / "alone.png"), seconds
        )
        rate = _throughput(shared, picture, folder, workers, seconds)
    return Speed(network, end_to_end, rate, peak_memory_mb())


def made_picture(width: int, height: int) -> bytes:
    """A JPEG of about the weight of a photograph: soft shapes under grain."""
    random = np.random.default_rng(0)
    coarse = random.uniform(30, 220, (6, 8, 3)).astype(np.float32)
    soft = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    grain = random.normal(0, 4, (height, width, 1)).astype(np.float32)
    pixels = np.clip(soft + grain, 0, 255).astype(np.uint8)
    return cv2.imencode(".jpg", pixels, (cv2.IMWRITE_JPEG_QUALITY, 90))[1].tobytes()


def peak_memory_mb() -> float | None:
    """Most resident memory of this process so far, in MB; None where the system does not tell."""
    if sys.platform == "win32":
        return None
    import resource  # noqa: PLC0415 - Windows has none

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / _MEGABYTE


def _convert(pipeline: Pipeline, picture: bytes, path: Path) -> None:
    frame = read_image(None, picture)
    Png16Writer().write(pipeline.predict(frame), path, frame)


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
