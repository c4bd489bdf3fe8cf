"""Who is told how a run goes, step by step."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

from depthcli.training.board import Board

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from depthcli.training.checkpoint import RunProgress
    from depthcli.training.config.schema import TrainConfig


class Watcher(Protocol):
    """Who is told how a run goes; with several processes, the first one's."""

    def step(self, progress: RunProgress, steps: int, losses: dict[str, float]) -> None:
        """A step of ``steps`` in all is done."""

    def epoch(self, progress: RunProgress) -> None:
        """An epoch is done, validated and saved."""


class Silent:
    """Shows nothing."""

    def step(self, progress: RunProgress, steps: int, losses: dict[str, float]) -> None:
        """Nothing."""

    def epoch(self, progress: RunProgress) -> None:
        """Nothing."""


class Both:
    """Two watchers in one."""

    def __init__(self, first: Watcher, second: Watcher) -> None:
        self._watchers = first, second

    def step(self, progress: RunProgress, steps: int, losses: dict[str, float]) -> None:
        """Tell both."""
        for watcher in self._watchers:
            watcher.step(progress, steps, losses)

    def epoch(self, progress: RunProgress) -> None:
        """Tell both."""
        for watcher in self._watchers:
            watcher.epoch(progress)


@contextmanager
def with_board(watcher: Watcher, folder: Path, config: TrainConfig) -> Iterator[Watcher]:
    """Also write event files for TensorBoard.

    Raises:
        TrainingError: its package is not installed.
    """
    board = Board(folder, config)
    try:
        yield Both(watcher, board)
    finally:
        board.close()
