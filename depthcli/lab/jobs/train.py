"""One training run: a method, a data set, and the folder that it is saved to and resumed from."""

import math
import signal
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from depthcli.core.parallel import Interrupt
from depthcli.lab.datasets.folders import open_paired_folder
from depthcli.lab.datasets.training_data import open_training_data
from depthcli.lab.options import Tracker
from depthcli.lab.training.callbacks import Callback
from depthcli.lab.training.config import TrainConfig
from depthcli.lab.training.init_weights import weights_file
from depthcli.lab.training.loggers import LOGGERS
from depthcli.lab.training.plugins import imported
from depthcli.lab.training.provenance import TrainState
from depthcli.lab.training.run import fit, open_fabric, set_threads


@dataclass(frozen=True, slots=True)
class TrainRequest:
    """Request to train."""

    config: TrainConfig  #: of the run; see :func:`depthcli.lab.training.settings.resolve_config`
    data: Path  #: the data set, as ``open_training_data`` takes it
    out: Path  #: folder for checkpoint, log and samples; a run in it is continued
    patterns: tuple[str, str] | None = None  #: names of images and depth, with ``*``
    pseudo_labels: Path | None = None  #: folder of additional pairs with less reliable depth
    init_weights: tuple[Path, ...] = ()  #: models or checkpoints, from whose mean a run starts
    minutes: float = math.inf  #: wall-clock minutes after which it stops
    accelerator: str = "auto"  #: auto, cpu, cuda or mps
    threads: int | None = None  #: CPU threads; None for those of the folder's run, or all cores
    trackers: tuple[Tracker, ...] = ()  #: tools that losses and scores are logged to
    #: ``module:function`` of folder and configuration, each of which returns a callback
    callbacks: tuple[str, ...] = ()
    signals: tuple[signal.Signals, ...] = ()  #: they stop it after a step, with a checkpoint


@dataclass(frozen=True, slots=True)
class TrainResult:
    """End of a training session."""

    state: TrainState  #: how far the run has come
    signal_number: int | None  #: the signal that ended it, or None


def train(request: TrainRequest, callback: Callback) -> TrainResult:
    """Train until the schedule, the time limit or a signal ends it."""
    config, out, options = request.config, request.out, request.config.data
    init_weights = [weights_file(source) for source in request.init_weights]
    own_callbacks = [imported(name) for name in request.callbacks]
    fabric = open_fabric(request.accelerator, config.precision)
    unit, patterns = options.units_per_metre, request.patterns
    data = open_training_data(request.data, options.split, unit, patterns, paired=options.paired)
    if request.pseudo_labels is not None:
        data = data.with_pseudo_labels(open_paired_folder(request.pseudo_labels))
    interrupt = Interrupt(*request.signals)
    with ExitStack() as stack:
        set_threads(request.threads, out)
        makers = (*(LOGGERS[tracker] for tracker in request.trackers), *own_callbacks)
        followers = [stack.enter_context(closing(make(out, config))) for make in makers]
        start = partial(fit, init_weights=init_weights, max_minutes=request.minutes)
        state = start(config, data, out, fabric, callback, *followers, interrupt=interrupt)
    return TrainResult(state, interrupt.number)
