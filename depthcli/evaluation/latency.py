"""How long models take for one picture, measured side by side."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from depthcli.inference.pipeline import Pipeline

_FEWEST, _MOST = 3, 30
_SECONDS_EACH = 1.0


def measure_ms(pipelines: Sequence[Pipeline]) -> tuple[float, ...]:
    """Median time of each network alone for one picture of its own size, milliseconds.

    The models take turns, so that whatever else the machine does meets all of them alike.
    """
    batches = [_batch(pipeline) for pipeline in pipelines]
    first_s = [_seconds(p, b) for p, b in zip(pipelines, batches, strict=True)]
    first_s = [min(s, _seconds(p, b)) for s, p, b in zip(first_s, pipelines, batches, strict=True)]
    rounds = [int(np.clip(_SECONDS_EACH / s, _FEWEST, _MOST)) for s in first_s]
    times_s: list[list[float]] = [[] for _ in pipelines]
    for turn in range(max(rounds, default=0)):
        for i, pipeline in enumerate(pipelines):
            if turn < rounds[i]:
                times_s[i].append(_seconds(pipeline, batches[i]))
    return tuple(1000 * float(np.median(times)) for times in times_s)


def _batch(pipeline: Pipeline) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    spec = pipeline.card.input
    shape = (1, spec.colour.channels, spec.height, spec.width)
    return np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)


def _seconds(pipeline: Pipeline, batch: np.ndarray[tuple[int, ...], np.dtype[np.float32]]) -> float:
    started = time.perf_counter()
    pipeline.session.run(batch)
    return time.perf_counter() - started
