"""Counts of the results of a batch so far."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from depthcli.io.manifest.row import Row
    from depthcli.jobs.batch.task import Result


class Tally:
    """Counts of results.

    Attributes:
        total: number of inputs.
        done: inputs that were processed, including the failed ones.
        kept: inputs whose outputs of an earlier run are still valid.
        failures: name and reason of those that failed.
        recent_failed: whether each of the last hundred processed inputs failed.
    """

    def __init__(self, total: int) -> None:
        self.total = total
        self.done = 0
        self.kept = 0
        self.failures: list[tuple[str, str]] = []
        self.recent_failed: deque[bool] = deque(maxlen=100)
        self._start_s = time.monotonic()

    def add(self, result: Result) -> None:
        """Count a result."""
        self.kept += result.is_kept
        self.done += not result.is_kept
        if not result.is_kept:
            self.recent_failed.append(result.row.error is not None)
        if result.row.error is not None:
            self.failures.append((result.row.input, result.row.error))

    def mark_lost(self, row: Row, *, was_kept: bool) -> None:
        """Count an input as failed that was counted as done or kept, as its outputs are gone."""
        self.kept -= was_kept
        self.done += was_kept
        self.failures.append((row.input, row.error or ""))

    @property
    def completed(self) -> int:
        """Inputs that are done or kept."""
        return self.done + self.kept

    @property
    def elapsed_s(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._start_s

    @property
    def rate(self) -> float:
        """Inputs per second, without those kept."""
        return self.done / max(self.elapsed_s, 1e-9)
