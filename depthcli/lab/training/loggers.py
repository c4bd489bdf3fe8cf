"""Loggers: losses, scores and sample images of a run for TensorBoard, Weights & Biases and MLflow.

Each is a subclass of :class:`Logger`, which says how numbers and an image are stored.
"""

import dataclasses
import os
import secrets
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np

from depthcli.errors import TrainingError
from depthcli.lab.options import Tracker
from depthcli.lab.training.callbacks import Callback, sample_path
from depthcli.lab.training.checkpoint import write_errors
from depthcli.lab.training.config import TrainConfig
from depthcli.lab.training.provenance import TrainState, named_settings

_PROJECT = "depthcli"


class Logger(Callback):
    """Logs every step and every validated epoch of the run in a folder.

    The extra ``TRACKER`` installs ``MODULE``, which is imported as ``package``.
    """

    TRACKER: ClassVar[Tracker]
    MODULE: ClassVar[str]

    def __init__(self, folder: Path, config: TrainConfig) -> None:
        self.folder, self.config = folder, config
        try:
            self.package: Any = import_module(self.MODULE)
        except ImportError as error:
            name = self.TRACKER
            install = f"pip install 'depthcli[{name}]'"
            raise TrainingError(f"the package {name} is missing: {install}") from error
        folder.mkdir(parents=True, exist_ok=True)

    @abstractmethod
    def log(self, values: Mapping[str, float], step: int, samples: Path | None = None) -> None:
        """Store numbers of a step by name, and its sample images, a JPEG file, if there are any."""

    def on_step_end(self, state: TrainState, steps: int, losses: dict[str, float]) -> None:
        """Log the losses and the learning rate."""
        optim = self.config.optim
        factor = optim.lr_factor(state.step - 1, steps // optim.epochs)
        values = {f"loss/{name}": value for name, value in losses.items()}
        with write_errors(self.folder):
            self.log(values | {"learning_rate": factor * optim.learning_rate}, state.step)

    def on_epoch_end(self, state: TrainState) -> None:
        """Log the scores and sample images of an epoch that was validated."""
        if state.scores:
            values = {f"held_out/{name}": value for name, value in state.scores.items()}
            with write_errors(self.folder):
                self.log(values, state.step, sample_path(self.folder, state.epoch))


class TensorBoardLogger(Logger):
    """Event files in ``tensorboard/``; steps that a resumed run repeats replace the earlier."""

    TRACKER, MODULE = Tracker.TENSORBOARD, "torch.utils.tensorboard"
    _writer: Any = None

    def log(self, values: Mapping[str, float], step: int, samples: Path | None = None) -> None:
        """Add scalars and pixels to the event file of this run."""
        folder = str(self.folder / "tensorboard")
        self._writer = self._writer or self.package.SummaryWriter(folder, purge_step=step)
        for name, value in values.items():
            self._writer.add_scalar(name, value, step)
        if samples:
            data = np.frombuffer(samples.read_bytes(), np.uint8)
            pixels = cv2.imdecode(data, cv2.IMREAD_COLOR_RGB)
            self._writer.add_image("samples", pixels, step, dataformats="HWC")
            self._writer.flush()

    def close(self) -> None:
        """Flush and close the event file."""
        with write_errors(self.folder):
            if self._writer:
                self._writer.close()


class WandbLogger(Logger):
    """A run of Weights & Biases, with its local files in ``wandb/``; ``WANDB_*`` configure it."""

    TRACKER, MODULE = Tracker.WANDB, "wandb"

    def __init__(self, folder: Path, config: TrainConfig) -> None:
        super().__init__(folder, config)
        try:
            self._run = self.package.init(
                project=os.environ.get("WANDB_PROJECT", _PROJECT),
                name=folder.resolve().name,
                dir=folder,
                id=_stored_id(folder / "wandb.id", partial(secrets.token_hex, 8)),
                resume="allow",
                config=dataclasses.asdict(config),
            )
        except self.package.Error as error:
            advice = "log in, or set WANDB_MODE=offline"
            raise TrainingError(f"Weights & Biases: {error}", advice) from error

    def log(self, values: Mapping[str, float], step: int, samples: Path | None = None) -> None:
        """Log numbers and the file under a step."""
        image = {"samples": self.package.Image(str(samples))} if samples else {}
        self._run.log({**values, **image}, step=step)

    def close(self) -> None:
        """End the run, which sends what is left."""
        self._run.finish()


class MlflowLogger(Logger):
    """A run of MLflow at ``MLFLOW_TRACKING_URI``, else in ``mlflow.db`` and ``mlruns/``.

    It uses the client, as MLflow's own functions keep the address of a first run for the next.
    """

    TRACKER, MODULE = Tracker.MLFLOW, "mlflow"

    def __init__(self, folder: Path, config: TrainConfig) -> None:
        super().__init__(folder, config)
        address = os.environ.get("MLFLOW_TRACKING_URI")
        self._artifacts = None if address else (folder / "mlruns").resolve().as_uri()
        address = address or f"sqlite:///{(folder / 'mlflow.db').resolve()}"
        try:
            self._client = self.package.MlflowClient(address)
            self._id = _stored_id(folder / "mlflow.id", self._new_run)
            self._client.update_run(self._id, "RUNNING")
        except self.package.MlflowException as error:
            raise TrainingError(f"MLflow: {error}", "check MLFLOW_TRACKING_URI") from error

    def _new_run(self) -> str:
        experiment = self._client.get_experiment_by_name(_PROJECT)
        number = experiment.experiment_id if experiment else None
        number = number or self._client.create_experiment(_PROJECT, self._artifacts)
        run = self._client.create_run(number, run_name=self.folder.resolve().name)
        for name, value in named_settings(self.config):
            self._client.log_param(run.info.run_id, name, value)
        return str(run.info.run_id)

    def log(self, values: Mapping[str, float], step: int, samples: Path | None = None) -> None:
        """Log numbers under a step, and the file, whose name has the epoch."""
        metric, now_ms = self.package.entities.Metric, int(1000 * time.time())
        metrics = [metric(name, value, now_ms, step) for name, value in values.items()]
        self._client.log_batch(self._id, metrics)
        if samples:
            self._client.log_artifact(self._id, str(samples), "samples")

    def close(self) -> None:
        """Mark the run as ended."""
        self._client.set_terminated(self._id)


LOGGERS = {kind.TRACKER: kind for kind in (TensorBoardLogger, WandbLogger, MlflowLogger)}
"""The logger of each tool."""


def _stored_id(path: Path, new: Callable[[], str]) -> str:
    """The id of the run, under which a resumed one goes on."""
    if not path.is_file():
        path.write_text(f"{new()}\n", "utf-8")
    return path.read_text("utf-8").strip()
