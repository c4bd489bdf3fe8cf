"""What TensorBoard shows of a run: losses, learning rate, validation and sample pictures."""

from pathlib import Path

import cv2
import numpy as np

from depthcli.core.extras import INSTALL_TENSORBOARD
from depthcli.errors import TrainingError
from depthcli.training.checkpoint import RunProgress
from depthcli.training.config.schema import TrainConfig
from depthcli.training.folder import writing
from depthcli.training.samples import sample_path
from depthcli.training.schedule import factor
from depthcli.training.watchers import Watcher

FOLDER = "tensorboard"


class Board(Watcher):
    """A watcher that also writes event files to ``tensorboard/`` in the folder of a run.

    Steps that a continued run repeats replace those of before; ``watcher`` is told as well.

    Raises:
        TrainingError: the package ``tensorboard`` is not installed.
    """

    def __init__(self, watcher: Watcher, folder: Path, config: TrainConfig) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter  # noqa: PLC0415 - optional, slow
        except ImportError as error:
            raise TrainingError(
                f"--tensorboard needs tensorboard: {INSTALL_TENSORBOARD}"
            ) from error
        self._open, self._watcher = SummaryWriter, watcher
        self._folder, self._config = folder, config
        self._writer: SummaryWriter | None = None

    def step(self, progress: RunProgress, steps: int, losses: dict[str, float]) -> None:
        """Losses and learning rate of a step."""
        self._watcher.step(progress, steps, losses)
        optim = self._config.optim
        share = factor(optim, progress.step - 1, steps // optim.epochs)
        values = {f"loss/{name}": value for name, value in losses.items()}
        values["learning_rate"] = share * optim.learning_rate
        with writing(self._folder):
            if self._writer is None:
                where = str(self._folder / FOLDER)
                self._writer = self._open(where, purge_step=progress.step)
            for name, value in values.items():
                self._writer.add_scalar(name, value, progress.step)

    def epoch(self, progress: RunProgress) -> None:
        """Scores and sample pictures of an epoch that was validated."""
        self._watcher.epoch(progress)
        path = sample_path(self._folder, progress.epoch)
        if self._writer is None or not path.is_file():
            return
        with writing(self._folder):
            for name, value in progress.scores.items():
                self._writer.add_scalar(f"held_out/{name}", value, progress.step)
            pixels = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_COLOR_RGB)
            self._writer.add_image("samples", pixels, progress.step, dataformats="HWC")
            self._writer.flush()

    def close(self) -> None:
        """Write what is still held back."""
        if self._writer is not None:
            with writing(self._folder):
                self._writer.close()
