"""Logging a run to TensorBoard: losses, learning rate, validation scores, sample pictures."""

from pathlib import Path

import cv2
import numpy as np

from depthcli.core.extras import INSTALL_TENSORBOARD
from depthcli.errors import TrainingError
from depthcli.training.callbacks import Callback
from depthcli.training.checkpoint import TrainState
from depthcli.training.config.schema import TrainConfig
from depthcli.training.folder import write_errors
from depthcli.training.samples import sample_path
from depthcli.training.schedule import lr_factor

FOLDER = "tensorboard"


class TensorBoardLogger(Callback):
    """Writes event files to ``tensorboard/`` in the folder of a run, then calls ``callback``.

    Steps that a resumed run repeats replace the earlier ones.

    Raises:
        TrainingError: the package ``tensorboard`` is not installed.
    """

    def __init__(self, callback: Callback, folder: Path, config: TrainConfig) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter  # noqa: PLC0415 - optional, slow
        except ImportError as error:
            raise TrainingError(
                f"the package tensorboard is missing: {INSTALL_TENSORBOARD}"
            ) from error
        self._writer_class, self._callback = SummaryWriter, callback
        self._folder, self._config = folder, config
        self._writer: SummaryWriter | None = None

    def on_step_end(self, state: TrainState, steps: int, losses: dict[str, float]) -> None:
        """Log the losses and the learning rate."""
        self._callback.on_step_end(state, steps, losses)
        optim = self._config.optim
        share = lr_factor(optim, state.step - 1, steps // optim.epochs)
        values = {f"loss/{name}": value for name, value in losses.items()}
        values["learning_rate"] = share * optim.learning_rate
        with write_errors(self._folder):
            if self._writer is None:
                where = str(self._folder / FOLDER)
                self._writer = self._writer_class(where, purge_step=state.step)
            for name, value in values.items():
                self._writer.add_scalar(name, value, state.step)

    def on_epoch_end(self, state: TrainState) -> None:
        """Log the scores and sample pictures of an epoch that was validated."""
        self._callback.on_epoch_end(state)
        path = sample_path(self._folder, state.epoch)
        if self._writer is None or not path.is_file():
            return
        with write_errors(self._folder):
            for name, value in state.scores.items():
                self._writer.add_scalar(f"held_out/{name}", value, state.step)
            pixels = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_COLOR_RGB)
            self._writer.add_image("samples", pixels, state.step, dataformats="HWC")
            self._writer.flush()

    def close(self) -> None:
        """Flush and close the event file."""
        if self._writer is not None:
            with write_errors(self._folder):
                self._writer.close()
