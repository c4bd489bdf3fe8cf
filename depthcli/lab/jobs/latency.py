"""Measuring latency, of one action or of several in turn, such as networks."""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from depthcli.inference.pipeline import Pipeline

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
