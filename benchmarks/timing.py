"""How the benchmarks measure: medians of alternating runs, ratios within one run, the noise."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_SETTLE_S = 0.05
"""Idle threads of the action before spin for a while."""


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
