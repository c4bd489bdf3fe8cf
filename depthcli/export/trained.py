"""Exporting training runs for evaluation, once per checkpoint."""

import dataclasses
import hashlib
import json
from pathlib import Path

from depthcli._version import __version__
from depthcli.core.options import Weights
from depthcli.datasets.base import NYU
from depthcli.errors import ModelError, OutputError, UsageError
from depthcli.export.onnx import ExportOptions, export_checkpoint
from depthcli.models.catalog import ModelLocation, read_model
from depthcli.training.checkpoint import CHECKPOINT, load_generator
from depthcli.training.config import TrainConfig
from depthcli.training.provenance import DataProvenance, TrainedRun

CACHE_NAMES = {Weights.AVERAGED: "evaluated.onnx", Weights.RAW: "evaluated-raw.onnx"}
_HASH_LENGTH = 16


def find_runs(folder: Path) -> tuple[Path, ...]:
    """The folder itself or its subfolders that have a checkpoint, sorted by name.

    Raises:
        UsageError: there is none.
    """
    if (folder / CHECKPOINT).is_file():
        return (folder,)
    found = tuple(sorted(path.parent for path in folder.glob(f"*/{CHECKPOINT}")))
    if not found:
        raise UsageError(f"{folder} holds no run of 'depthcli train'")
    return found


def open_run(folder: Path) -> TrainedRun:
    """Facts about a run from its checkpoint.

    Raises:
        CheckpointError: it cannot be used.
    """
    generator, saved = load_generator(folder / CHECKPOINT)
    config, state, provenance = saved.config, saved.state, saved.provenance
    return TrainedRun(
        folder=folder,
        seed=config.seed,
        settings=_settings(config, provenance),
        paired=config.data.paired,
        parameters=sum(weights.numel() for weights in generator.parameters()),
        epochs=state.epoch,
        epochs_planned=config.optim.epochs,
        steps=state.step,
        minutes=state.seconds / 60,
        train_ids=provenance.train_ids,
        held_out_ids=provenance.held_out_ids,
        nyu_ids=provenance.seen_ids.get(NYU, ()),
    )


def _settings(config: TrainConfig, data: DataProvenance) -> str:
    """Settings that seeds of one experiment have in common, as JSON."""
    settings = dataclasses.asdict(dataclasses.replace(config, seed=0))
    labels = [data.pseudo_labels, data.pseudo_label_ids, data.pseudo_label_fingerprint]
    sources = [data.data, data.train_ids, labels, data.init_weights]
    return json.dumps([settings, sources])


def export_run(run: TrainedRun, fallback_folder: Path, weights: Weights = Weights.AVERAGED) -> Path:
    """Export a run's model, unless that was done already for the same checkpoint.

    The file is in the run's folder, or in ``fallback_folder`` if that cannot be written.

    Raises:
        CheckpointError: the checkpoint cannot be used.
        ParityError: the exported model differs from torch's network.
    """
    checkpoint, cached = run.folder / CHECKPOINT, run.folder / CACHE_NAMES[weights]
    with checkpoint.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()[:_HASH_LENGTH]
    version = f"checkpoint-{digest}-{__version__}"  # other versions may export other models
    if _version(cached) == version:
        return cached
    options = ExportOptions(name=run.name, version=version, weights=weights)
    try:
        return export_checkpoint(checkpoint, cached, options).path
    except OutputError:
        return export_checkpoint(checkpoint, fallback_folder / run.name / cached.name, options).path


def _version(model: Path) -> str | None:
    """The version in the card inside an ONNX file; None if there is no valid file."""
    if not model.is_file():
        return None
    try:
        return read_model(ModelLocation(onnx=model, card=None)).card.version
    except ModelError:
        return None
