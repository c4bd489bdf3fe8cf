"""What is known of a run that was trained; free of torch, so that tables can be made of it."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class TrainedRun:
    """What a run's checkpoint says."""

    folder: Path  #: where it lives
    seed: int  #: of weights, order and augmentation
    settings: str  #: all settings but the seed, as JSON
    paired: bool  #: whether the configuration shows pictures and depth of one scene point together
    parameters: int  #: weights of the generator
    epochs: int  #: whole epochs done
    epochs_planned: int  #: epochs of the whole schedule
    steps: int  #: optimisation steps done
    minutes: float  #: training time
    train_ids: tuple[str, ...]  #: pairs it was trained on
    held_out_ids: tuple[str, ...]  #: pairs it was validated on

    @property
    def name(self) -> str:
        """Name of its folder."""
        return self.folder.resolve().name
