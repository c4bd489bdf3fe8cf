"""Exporting a checkpoint to an ONNX file and its card, after a parity check."""

import dataclasses
import hashlib
from dataclasses import dataclass
from pathlib import Path

from onnx import helper

from depthcli.errors import CheckpointError, UsageError
from depthcli.export.card import card_of, card_path
from depthcli.export.graph import (
    MirrorAverage,
    build_graph,
    fold_batch_norm,
    weights_to_float16,
)
from depthcli.export.int8 import calibration_batches, quantize
from depthcli.export.options import ExportOptions
from depthcli.export.parity import Parity, check_parity
from depthcli.io.storage.atomic import atomic_path
from depthcli.models.card import METADATA_KEY, ModelCard
from depthcli.models.card_specs import InputSpec
from depthcli.models.catalog import file_of_card
from depthcli.training.checkpoint import load_generator
from depthcli.training.methods.registry import method_class


@dataclass(frozen=True, slots=True)
class ExportResult:
    """The result of an export."""

    path: Path  #: the ONNX file
    card: ModelCard  #: its card, written beside it
    parity: Parity  #: difference from torch


def check_predicts_depth(checkpoint: Path, method: str) -> None:
    """Check that a checkpoint is of a method that learns depth.

    Raises:
        CheckpointError: it is of one that learns from pictures alone.
    """
    if not method_class(method).DEPTH:
        raise CheckpointError(
            f"{checkpoint} learned from pictures alone and predicts no depth: train another method "
            "with --init"
        )


def export_checkpoint(checkpoint: Path, out: Path, options: ExportOptions) -> ExportResult:
    """Export the generator of a checkpoint to an ONNX file, with its card beside it.

    Raises:
        CheckpointError: the checkpoint cannot be used.
        UsageError: the value of an option is not valid in a card, or the card there is that of
            another model.
        ParityError: the ONNX model differs from torch's network; nothing is written.
        OutputError: a file cannot be written.
    """
    _check_own_card(out)
    generator, saved = load_generator(checkpoint, options.weights)
    check_predicts_depth(checkpoint, saved.config.method)
    model = build_graph(generator, opset=options.opset, mirror=options.mirror)
    card = card_of(saved, options)
    folder = options.int8_pictures
    pictures = [] if folder is None else calibration_batches(folder, card.input)
    if pictures:
        model = quantize(model, pictures)
    elif options.half:
        weights_to_float16(model)
    helper.set_model_props(model, {METADATA_KEY: card.to_json()})
    data = model.SerializeToString()
    network = MirrorAverage(fold_batch_norm(generator)) if options.mirror else generator
    cases = _parity_cases(card.input)[: 1 if pictures else None]
    parity = check_parity(network, data, cases, options.max_difference, pictures)
    card = dataclasses.replace(
        card, file=out.name, sha256=hashlib.sha256(data).hexdigest(), size_bytes=len(data)
    )
    with (  # both are written before either is renamed, as old and new ones do not match
        atomic_path(out, inputs=[checkpoint]) as path,
        atomic_path(card_path(out), inputs=[checkpoint]) as card_file,
    ):
        path.write_bytes(data)
        card_file.write_text(card.to_json(), "utf-8")
    return ExportResult(out, card, parity)


def _check_own_card(out: Path) -> None:
    card = card_path(out)
    if card.is_file() and file_of_card(card) != out.name:
        raise UsageError(f"{card} is not the card of {out.name}; choose another -o")


def _parity_cases(spec: InputSpec) -> tuple[tuple[int, int, int], ...]:
    """(batch, height, width): nominal size, a batch, other aspect ratios, a larger size."""
    height, width = spec.height, spec.width
    half = max(spec.multiple_of, height // 2 // spec.multiple_of * spec.multiple_of)
    return (
        (1, height, width),
        (3, height, width),
        (1, width, height),
        (2, half, width),
        (1, 2 * height, 2 * width),
    )
