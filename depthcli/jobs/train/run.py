"""One run: a method trained on a data set, in a folder that it is continued from."""

import math
import signal
from contextlib import closing, nullcontext
from dataclasses import dataclass
from pathlib import Path

from depthcli.core.interrupt import Interrupt
from depthcli.datasets.paired_folder import open_paired_folder
from depthcli.datasets.training_data import TrainingData, open_training_data
from depthcli.training import loop
from depthcli.training.board import Board
from depthcli.training.checkpoint import RunProgress
from depthcli.training.config.schema import TrainConfig
from depthcli.training.launch import launched, open_fabric
from depthcli.training.setup import divide
from depthcli.training.threads import set_threads
from depthcli.training.watchers import TrainStart, Watcher


@dataclass(frozen=True, slots=True)
class TrainRequest:
    """What is trained, and how."""

    config: TrainConfig  #: of the run; see :func:`depthcli.training.resolve.resolve_config`
    #: the data set, as :func:`~depthcli.datasets.training_data.open_training_data` takes it
    data: Path
    out: Path  #: folder for checkpoint, log and samples; a run in it is continued
    extra: Path | None = None  #: folder of pairs whose metres are less sure
    #: exported models or checkpoints; a new run starts from the mean of their weights
    start: tuple[Path, ...] = ()
    minutes: float = math.inf  #: wall-clock minutes of this sitting
    accelerator: str = "auto"  #: auto, cpu, cuda or mps
    devices: int = 1  #: GPUs, or CPU processes
    threads: int | None = None  #: CPU threads; None for those of the folder's run, or the fastest
    tensorboard: bool = False  #: also write event files for TensorBoard
    #: those that end it after the step at hand, with a checkpoint
    signals: tuple[signal.Signals, ...] = ()


@dataclass(frozen=True, slots=True)
class TrainResult:
    """How a sitting ended."""

    progress: RunProgress  #: how far the run has come
    signal_number: int | None  #: the signal that ended it, or None
    is_first: bool  #: whether this process speaks for the run; of several, only the first does


def train(request: TrainRequest, watcher: Watcher) -> TrainResult:
    """Train until the schedule, the time limit or a signal ends it.

    With several devices this same command is started again for each of them.

    Raises:
        UsageError: the accelerator, devices or settings do not fit together.
        DatasetError: the data set cannot be used.
        CheckpointError: the folder holds another run, or a checkpoint cannot be written.
        TrainingError: training cannot go on; the last checkpoint is kept.
    """
    config, out = request.config, request.out
    fabric = open_fabric(request.accelerator, config.precision, request.devices)
    data = _data(request)
    with launched(fabric):
        first = fabric.is_global_zero
        threads = set_threads(request.threads, config, out, fabric)
        if first:
            lacks_scenes = (
                bool(config.data.holdout_every) and not divide(data.dataset, config.data)[1]
            )
            watcher.begin(TrainStart(threads, lacks_scenes))
        board = Board(watcher, out, config) if request.tensorboard and first else None
        interrupt = Interrupt(*request.signals)
        with closing(board) if board else nullcontext(watcher) as told:
            limits = loop.Limits(minutes=request.minutes)
            done = loop.fit(config, data, out, fabric, told, limits, interrupt, request.start)
    return TrainResult(done, interrupt.number, first)


def _data(request: TrainRequest) -> TrainingData:
    wanted = request.config.data
    data = open_training_data(
        request.data,
        paired=wanted.paired,
        split=wanted.split,
        units_per_metre=wanted.units_per_metre,
    )
    return data if request.extra is None else data.with_extra(open_paired_folder(request.extra))
