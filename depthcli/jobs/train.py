"""One training run: a method, a data set, and the folder that it is saved to and resumed from."""

import math
import signal
from collections.abc import Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass
from pathlib import Path

from depthcli.core.progress import Interrupt
from depthcli.datasets.folders import open_paired_folder
from depthcli.datasets.training_data import TrainingData, open_training_data
from depthcli.errors import CheckpointError
from depthcli.models.catalog import find_model
from depthcli.training import loop
from depthcli.training.callbacks import Callback, TensorBoardLogger, TrainStart
from depthcli.training.checkpoint import TrainState
from depthcli.training.config import TrainConfig
from depthcli.training.devices import Threads, launched, open_fabric, set_threads
from depthcli.training.init_weights import is_encoder_file, narrowed_decoder, seen_by_files
from depthcli.training.methods.registry import method_class
from depthcli.training.provenance import common_ids, train_val_split

_CHECKPOINT_SUFFIX = ".ckpt"
_ONNX_SUFFIX = ".onnx"


def weights_file(source: Path) -> Path:
    """The checkpoint, or the ONNX file of a model; of an int8 model, that of its float model.

    Args:
        source: a checkpoint, or a model as :func:`~depthcli.models.catalog.find_model` takes it.

    Raises:
        CheckpointError: there is no such checkpoint.
        ModelError: there is no such model, or it is damaged.
    """
    if is_encoder_file(source) or (source.suffix != _ONNX_SUFFIX and source.is_file()):
        return source
    if source.suffix == _CHECKPOINT_SUFFIX:
        raise CheckpointError(f"no checkpoint at {source}")
    model = find_model(source)
    return find_model(model.card.float_model).path if model.card.float_model else model.path


@dataclass(frozen=True, slots=True)
class TrainRequest:
    """Request to train."""

    config: TrainConfig  #: of the run; see :func:`depthcli.training.settings.resolve_config`
    #: the data set, as :func:`~depthcli.datasets.training_data.open_training_data` takes it
    data: Path
    out: Path  #: folder for checkpoint, log and samples; a run in it is continued
    pseudo_labels: Path | None = None  #: folder of additional pairs with less reliable depth
    #: models or checkpoints, as :func:`~depthcli.jobs.train` takes them;
    #: a new run starts from the mean of their weights
    init_weights: tuple[Path, ...] = ()
    minutes: float = math.inf  #: wall-clock minutes after which it stops
    accelerator: str = "auto"  #: auto, cpu, cuda or mps
    devices: int = 1  #: GPUs, or CPU processes
    threads: int | None = None  #: CPU threads; None for those of the folder's run, or the fastest
    tensorboard: bool = False  #: also write event files for TensorBoard
    #: signals that stop it after the current step, with a checkpoint
    signals: tuple[signal.Signals, ...] = ()


@dataclass(frozen=True, slots=True)
class TrainResult:
    """End of a training session."""

    state: TrainState  #: how far the run has come
    signal_number: int | None  #: the signal that ended it, or None
    is_global_zero: bool  #: whether this is the process with global rank 0


def train(request: TrainRequest, callback: Callback) -> TrainResult:
    """Train until the schedule, the time limit or a signal ends it.

    With several devices the command is launched once per device.

    Raises:
        UsageError: the accelerator, devices or settings do not fit together.
        DatasetError: the data set cannot be used.
        ModelError: there is no such model to start from, or it is damaged.
        CheckpointError: the folder holds another run, or a checkpoint cannot be read or written.
        TrainingError: training cannot continue; the last checkpoint is kept.
    """
    config, out = request.config, request.out
    init_weights = [weights_file(source) for source in request.init_weights]
    fabric = open_fabric(request.accelerator, config.precision, request.devices)
    data = _data(request)
    with launched(fabric):
        first = fabric.is_global_zero
        threads = set_threads(request.threads, config, out, fabric)
        if first:
            callback.on_train_start(_facts(threads, config, data, init_weights))
        logger = TensorBoardLogger(callback, out, config) if request.tensorboard and first else None
        interrupt = Interrupt(*request.signals)
        with closing(logger) if logger else nullcontext(callback) as listener:
            limits = loop.Limits(minutes=request.minutes)
            done = loop.fit(config, data, out, fabric, listener, limits, interrupt, init_weights)
    return TrainResult(done, interrupt.number, first)


def _facts(
    threads: Threads, config: TrainConfig, data: TrainingData, init_weights: Sequence[Path]
) -> TrainStart:
    wanted = bool(config.data.holdout_every) and method_class(config.method).DEPTH
    held_out = train_val_split(data.dataset, config.data)[1] if wanted else []
    held_out_ids = [data.dataset.ids[i] for i in held_out]
    seen_held_out = common_ids(data, held_out_ids, seen_by_files(init_weights))
    return TrainStart(
        threads,
        lacks_scenes=wanted and not held_out,
        seen_held_out=len(seen_held_out),
        narrowed_decoder=narrowed_decoder(config.generator, init_weights),
    )


def _data(request: TrainRequest) -> TrainingData:
    wanted = request.config.data
    data = open_training_data(
        request.data,
        paired=wanted.paired,
        depth=method_class(request.config.method).DEPTH,
        split=wanted.split,
        units_per_metre=wanted.units_per_metre,
    )
    labels = request.pseudo_labels
    return data if labels is None else data.with_pseudo_labels(open_paired_folder(labels))
