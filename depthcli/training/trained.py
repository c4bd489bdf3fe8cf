"""Facts about a finished or stopped run; without torch, for tables."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class TrainedRun:
    """Facts from a run's checkpoint."""

    folder: Path  #: its folder
    seed: int  #: of weights, order and augmentation
    settings: str  #: all settings but the seed, data and init weights, as JSON
    paired: bool  #: whether it was trained with aligned pairs of picture and depth
    parameters: int  #: weights of the generator
    epochs: int  #: whole epochs done
    epochs_planned: int  #: epochs of the whole schedule
    steps: int  #: optimization steps done
    minutes: float  #: training time in minutes
    train_ids: tuple[str, ...]  #: pairs it was trained on
    held_out_ids: tuple[str, ...]  #: pairs it was validated on
    nyu_ids: tuple[str, ...]  #: pairs of NYU that it or its init weights were trained on

    @property
    def name(self) -> str:
        """Name of its folder."""
        return self.folder.resolve().name
