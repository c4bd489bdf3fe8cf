"""Measuring latency, of one action or of several models in turn."""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from depthcli.core.types import Frame
from depthcli.errors import ModelError
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import Session

_WARMUP_RUNS = 3
_MIN_RUNS = 5
_ROUNDS = 3
_SECONDS_A_ROUND = 0.3
_MAX_RUNS_A_ROUND = 10


@dataclass(frozen=True, slots=True)
class Latency:
    """Wall-clock milliseconds of an action that was repeated."""

    median_ms: float  #: of the runs
    min_ms: float  #: of the runs
    noise: float  #: half the interquartile range of the runs, as a share of the median
    runs: int  #: how many were measured, after warm-up


def measure_latency(action: Callable[[], object], seconds: float) -> Latency:
    """Repeat an action for a number of seconds, and at least five times."""
    for _ in range(_WARMUP_RUNS):
        action()
    runs_ms: list[float] = []
    end_s = time.perf_counter() + seconds
    while len(runs_ms) < _MIN_RUNS or time.perf_counter() < end_s:
        runs_ms.append(1e3 * _elapsed_s(action))
    low, median, high = statistics.quantiles(runs_ms, n=4)
    return Latency(median, min(runs_ms), (high - low) / 2 / median, len(runs_ms))


def measure_ms(pipelines: Sequence[Pipeline]) -> tuple[float, ...]:
    """Median time of each network alone for one picture of its own size, milliseconds.

    The models take turns, so that other load on the machine affects all of them alike. The first
    run of a turn is not counted: threads of the previous model may still be spinning.
    """
    actions = [partial(pipeline.session.run, _batch(pipeline)) for pipeline in pipelines]
    times_s: list[list[float]] = [[] for _ in pipelines]
    for _ in range(_ROUNDS):
        for times, action in zip(times_s, actions, strict=True):
            count = int(np.clip(_SECONDS_A_ROUND / _elapsed_s(action), 1, _MAX_RUNS_A_ROUND))
            times += [_elapsed_s(action) for _ in range(count)]
    return tuple(1000 * float(np.median(times)) for times in times_s)


def _batch(pipeline: Pipeline) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    spec = pipeline.card.input
    shape = (1, spec.colour.channels, spec.height, spec.width)
    return np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)


def _elapsed_s(action: Callable[[], object]) -> float:
    started_s = time.perf_counter()
    action()
    return time.perf_counter() - started_s


_GRAY = 128


def try_session(session: Session) -> None:
    """Run a loaded model on a gray picture of its own size.

    Raises:
        ModelError: it does not run, or has no finite output.
    """
    spec = session.model.card.input
    _predict_gray(session, spec.height, spec.width)


def try_other_size(session: Session) -> None:
    """Run a model on a wider picture, if its card states that its input may have any size.

    Graphs of dynamic axes may still hold constants that suit one size, such as embeddings.

    Raises:
        ModelError: it does not run.
    """
    model = session.model
    spec = model.card.input
    if not spec.dynamic:
        return
    try:
        _predict_gray(session, spec.height, spec.width * 3 // 2)
    except ModelError as error:
        raise ModelError(
            f"{model.path} runs only on inputs of {spec.width} x {spec.height}, although its axes "
            "are dynamic; set input.dynamic to false and input.fit to stretch in the card"
        ) from error


def check_network(error: Exception, session: Session) -> None:
    """Check the network after it failed on an input; it may work for the next one.

    Raises:
        ModelError: the same, if the network also fails on a plain gray picture.
    """
    if isinstance(error, ModelError):
        try:
            try_session(session)
        except ModelError:
            raise error from None


def _predict_gray(session: Session, height: int, width: int) -> None:
    Pipeline(session).predict(Frame(np.full((height, width, 3), _GRAY, np.uint8)))
