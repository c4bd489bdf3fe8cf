"""Who is told how a run goes, step by step."""

from dataclasses import dataclass

from depthcli.training.checkpoint import RunProgress
from depthcli.training.threads import Threads


@dataclass(frozen=True, slots=True)
class TrainStart:
    """What is known of a run before its first step."""

    threads: Threads  #: CPU threads that it uses
    lacks_scenes: bool  #: whether pairs were to be held out and there are too few scenes for that


class Watcher:
    """Who is told how a run goes; with several processes, the first one's. This one is silent."""

    def begin(self, start: TrainStart) -> None:
        """The run is about to begin, or to go on."""

    def step(self, progress: RunProgress, steps: int, losses: dict[str, float]) -> None:
        """A step of ``steps`` in all is done."""

    def epoch(self, progress: RunProgress) -> None:
        """An epoch is done, validated and saved."""
