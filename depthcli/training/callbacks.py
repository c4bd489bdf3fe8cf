"""Callbacks of the training loop."""

from dataclasses import dataclass

from depthcli.training.checkpoint import TrainState
from depthcli.training.threads import Threads


@dataclass(frozen=True, slots=True)
class TrainStart:
    """Facts about a run before its first step."""

    threads: Threads  #: CPU threads that it uses
    lacks_scenes: bool  #: whether there are too few scenes to hold some out as configured
    seen_held_out: int  #: number of held-out pairs that the init weights were trained on
    #: decoder channels of the init weights and of the network, if they are narrowed to these
    narrowed_decoder: tuple[tuple[int, ...], tuple[int, ...]] | None = None
    #: settings of colour and depth in which the init weights differ, one text each
    other_coding: tuple[str, ...] = ()


class Callback:
    """Called during training, in the process with global rank 0. The base class does nothing."""

    def on_train_start(self, start: TrainStart) -> None:
        """Called before the first step, also of a resumed run."""

    def on_step_end(self, state: TrainState, steps: int, losses: dict[str, float]) -> None:
        """Called after each step; ``steps`` is their total number."""

    def on_epoch_end(self, state: TrainState) -> None:
        """Called after each epoch, once it is validated and saved."""
