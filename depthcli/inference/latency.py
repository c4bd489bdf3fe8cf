"""How long models take for one picture, measured side by side."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from depthcli.inference.pipeline import Pipeline

_TURNS = 3
_SECONDS_A_TURN = 0.3
_MOST_A_TURN = 10


def measure_ms(pipelines: Sequence[Pipeline]) -> tuple[float, ...]:
    """Median time of each network alone for one picture of its own size, milliseconds.

    The models take turns, so that whatever else the machine does meets all of them alike. The
    first picture of a turn is not counted: threads of the model before may still be awake.
    """
    batches = [_batch(pipeline) for pipeline in pipelines]
    times_s: list[list[float]] = [[] for _ in pipelines]
    for _ in range(_TURNS):
        for times, pipeline, batch in zip(times_s, pipelines, batches, strict=True):
            once_s = _seconds(pipeline, batch)
            count = int(np.clip(_SECONDS_A_TURN / once_s, 1, _MOST_A_TURN))
            times += [_seconds(pipeline, batch) for _ in range(count)]
    return tuple(1000 * float(np.median(times)) for times in times_s)


def _batch(pipeline: Pipeline) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    spec = pipeline.card.input
    shape = (1, spec.colour.channels, spec.height, spec.width)
    return np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)


def _seconds(pipeline: Pipeline, batch: np.ndarray[tuple[int, ...], np.dtype[np.float32]]) -> float:
    started = time.perf_counter()
    pipeline.session.run(batch)
    return time.perf_counter() - started
