"""What became of the inputs of a batch so far."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from depthcli.io.manifest.row import Row
    from depthcli.jobs.batch.task import Result


class Tally:
    """A count of results.

    Attributes:
        total: inputs in all.
        done: inputs worked on, the failed ones too.
        kept: inputs whose outputs of an earlier run are still right.
        failures: name and reason of those that failed.
        recent_failed: whether each of the last hundred that were worked on failed.
    """

    def __init__(self, total: int) -> None:
        self.total = total
        self.done = 0
        self.kept = 0
        self.failures: list[tuple[str, str]] = []
        self.recent_failed: deque[bool] = deque(maxlen=100)
        self._start_s = time.monotonic()

    def add(self, result: Result) -> None:
        """Count an input."""
        self.kept += result.is_kept
        self.done += not result.is_kept
        if not result.is_kept:
            self.recent_failed.append(result.row.error is not None)
        if result.row.error is not None:
            self.failures.append((result.row.input, result.row.error))

    def lose(self, row: Row, *, was_kept: bool) -> None:
        """Count an input that was counted as done as a failure after all."""
        self.kept -= was_kept
        self.done += was_kept
        self.failures.append((row.input, row.error or ""))

    @property
    def passed(self) -> int:
        """Inputs that are over with."""
        return self.done + self.kept

    @property
    def elapsed_s(self) -> float:
        """Seconds since the beginning."""
        return time.monotonic() - self._start_s

    @property
    def rate(self) -> float:
        """Inputs a second; those kept took no time and do not count."""
        return self.done / max(self.elapsed_s, 1e-9)
