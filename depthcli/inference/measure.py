"""Measuring latency, of one action or of several models in turn."""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from depthcli.core.anchors import AnchorPoints
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import ModelError
from depthcli.inference.pipeline import NETWORK_FROM, Pipeline
from depthcli.inference.session import Session

_ROUNDS = 3
_MIN_RUNS = 5


@dataclass(frozen=True, slots=True)
class Latency:
    """Wall-clock milliseconds of an action that was repeated."""

    median_ms: float  #: of the runs
    min_ms: float  #: of the runs
    noise: float  #: half the interquartile range of the runs, as a share of the median
    runs: int  #: how many were measured, after warm-up


def measure_latencies(actions: Sequence[Callable[[], object]], seconds: float) -> list[Latency]:
    """Repeat each action for a number of seconds, and at least five times.

    They take turns, so that other load on the machine affects all of them alike. The first run of a
    turn is not counted: threads of the previous action may still be spinning.
    """
    times_ms: list[list[float]] = [[] for _ in actions]
    for turn in range(1, _ROUNDS + 1):
        for runs_ms, action in zip(times_ms, actions, strict=True):
            action()
            end_s = time.perf_counter() + seconds / _ROUNDS
            while len(runs_ms) < turn * _MIN_RUNS / _ROUNDS or time.perf_counter() < end_s:
                runs_ms.append(1e3 * _elapsed_s(action))
    found = []
    for runs_ms in times_ms:
        low, median, high = statistics.quantiles(runs_ms, n=4)
        found.append(Latency(median, min(runs_ms), (high - low) / 2 / median, len(runs_ms)))
    return found


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


_GRAY = 128


def try_session(session: Session) -> None:
    """Run a loaded model on a gray picture of its own size."""
    spec = session.model.card.input
    _predict_gray(session, spec.height, spec.width)


def try_other_size(session: Session) -> None:
    """Run a model on a wider picture, if its card states that its input may have any size.

    Graphs of dynamic axes may still hold constants that suit one size, such as embeddings.
    """
    model = session.model
    spec = model.card.input
    if not spec.dynamic:
        return
    try:
        _predict_gray(session, spec.height, spec.width * 3 // 2)
    except ModelError as error:
        size = f"{spec.width} x {spec.height}"
        raise ModelError(
            f"{model.path} runs only on inputs of {size}, although its axes are dynamic",
            "set input.dynamic to false and input.fit to stretch in the card",
        ) from error


def check_network(error: Exception, session: Session) -> None:
    """Check the network after it failed on an input; it may work for the next one."""
    if isinstance(error, ModelError):
        try:
            try_session(session)
        except ModelError:
            raise error from None


def _predict_gray(session: Session, height: int, width: int) -> None:
    depth_for_trial(Pipeline(session), Frame(np.full((height, width, 3), _GRAY, np.uint8)))


def depth_for_trial(pipeline: Pipeline, frame: Frame) -> DepthMap:
    """Depth of a picture; a network that needs known depth gets that of a slope."""
    if pipeline.card.input.known_depth is None:
        return pipeline.predict(frame).depth
    columns, rows = frame.display_size_px
    slope = np.linspace((0, 0, 1), (columns - 1, rows - 1, 2), NETWORK_FROM)
    return pipeline.predict(frame, anchors=AnchorPoints.of_table(slope)).depth
