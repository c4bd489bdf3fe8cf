"""Setting up a run before its first step: pairs, networks, folder, and resuming."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch
from lightning_fabric import Fabric
from torch import Tensor

from depthcli.datasets.training_data import TrainingData
from depthcli.errors import UsageError
from depthcli.training import metrics_log
from depthcli.training.config.ranges import check_batch
from depthcli.training.config.schema import TrainConfig
from depthcli.training.data.batches import Batches
from depthcli.training.data.pair_store import PairStore, whole_pictures
from depthcli.training.folder import CHECKPOINT, METRICS_LOG, write_errors
from depthcli.training.initial_weights import seen_by_files
from depthcli.training.methods.registry import method_class
from depthcli.training.provenance import (
    check_pseudo_labels,
    provenance_of,
    train_val_split,
)
from depthcli.training.run import Run
from depthcli.training.validation import Validation

_EXAMPLES = 128  # pictures, by which the decoder channels of init weights are chosen


@dataclass(frozen=True, slots=True)
class TrainingSetup:
    """Everything that the training loop needs."""

    run: Run  #: networks, optimizers and progress
    batches: Batches  #: the training batches, by step
    #: the held-out pairs; None without them, and in processes after the first
    validation: Validation | None


def set_up(
    config: TrainConfig,
    data: TrainingData,
    folder: Path,
    fabric: Fabric,
    init_weights: Sequence[Path],
) -> TrainingSetup:
    """Read the pairs, build the networks, and load the folder's checkpoint if there is one.

    Arguments and errors as of :func:`depthcli.training.loop.fit`.
    """
    dataset, first = data.dataset, fabric.is_global_zero
    train_rows, held_out = train_val_split(dataset, config.data)
    provenance = provenance_of(config, data)
    check_pseudo_labels(data, provenance)
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    store = PairStore(dataset, train_rows, config.data)
    batches = Batches(
        store,
        config.data,
        config.optim.batch_size,
        config.seed,
        fabric.device,
        fabric.global_rank,
        fabric.world_size,
        _pseudo_label_store(data, config),
    )
    check_batch(config, batches.own_size)
    scored = held_out and first and method_class(config.method).DEPTH
    validation = Validation(dataset, held_out, config) if scored else None
    run = Run(config, fabric, batches.steps_per_epoch)
    if init_weights:
        origin = run.load_init_weights(init_weights, partial(_examples, store, config))
        ids = seen_by_files(init_weights)
        provenance = replace(provenance, init_weights=origin, init_ids=ids)
    run.provenance = provenance
    run.resume(folder / CHECKPOINT)
    run.state = replace(run.state, threads=torch.get_num_threads())
    if first:
        with write_errors(folder):
            metrics_log.truncate(folder / METRICS_LOG, run.state.step)
    return TrainingSetup(run, batches, validation)


def _examples(store: PairStore, config: TrainConfig) -> Tensor:
    """Evenly spaced training pictures (B, 1, H, W) in [-1, 1], without augmentation."""
    rows = torch.linspace(0, len(store) - 1, min(len(store), _EXAMPLES)).long()
    return whole_pictures(store, config.data, rows)


def _pseudo_label_store(data: TrainingData, config: TrainConfig) -> PairStore | None:
    if data.pseudo_labels is None:
        return None
    if config.output.coding != "log" or config.method != "proposed":
        raise UsageError("pseudo labels need the method proposed and output.coding=log")
    return PairStore(data.pseudo_labels, range(len(data.pseudo_labels)), config.data)
