"""A checkpoint to a model folder: one ONNX file and its card, gated by parity."""

import dataclasses
import hashlib
from dataclasses import dataclass
from pathlib import Path

from depthcli.export.card import card_of, card_path
from depthcli.export.graph import MirrorAverage, build_graph, folded, halve_weights, set_metadata
from depthcli.export.int8 import calibration_batches, quantize
from depthcli.export.options import ExportOptions
from depthcli.export.parity import Parity, check_parity
from depthcli.io.storage.atomic import atomic_path
from depthcli.models.card import METADATA_KEY, ModelCard
from depthcli.models.card_specs import InputSpec
from depthcli.training.checkpoint import load_generator


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written."""

    path: Path  #: the ONNX file
    card: ModelCard  #: its card, written beside it
    parity: Parity  #: how close it is to torch


def export_checkpoint(checkpoint: Path, out: Path, options: ExportOptions) -> Exported:
    """Export the generator of a checkpoint to an ONNX file, with its card beside it.

    Raises:
        CheckpointError: the checkpoint cannot be used.
        UsageError: a card cannot hold what an option says.
        ParityError: the result is not the network; nothing is written.
        OutputError: a file cannot be written.
    """
    generator, saved = load_generator(checkpoint, options.weights)
    model = build_graph(generator, opset=options.opset, mirror=options.mirror)
    card = card_of(saved, options)
    folder = options.int8_pictures
    pictures = [] if folder is None else calibration_batches(folder, card.input)
    if pictures:
        model = quantize(model, pictures)
    elif options.half:
        halve_weights(model)
    set_metadata(model, {METADATA_KEY: card.to_json()})
    data = model.SerializeToString()
    network = MirrorAverage(folded(generator)) if options.mirror else generator
    cases = _cases(card.input)[: 1 if pictures else None]
    parity = check_parity(network, data, cases, options.allowed, pictures)
    card = dataclasses.replace(
        card, file=out.name, sha256=hashlib.sha256(data).hexdigest(), size_bytes=len(data)
    )
    with (  # both are written before either takes its place: an old one would not fit the new
        atomic_path(out, inputs=[checkpoint]) as path,
        atomic_path(card_path(out), inputs=[checkpoint]) as card_file,
    ):
        path.write_bytes(data)
        card_file.write_text(card.to_json(), "utf-8")
    return Exported(out, card, parity)


def _cases(spec: InputSpec) -> tuple[tuple[int, int, int], ...]:
    """The nominal size, a batch, other aspects, and a larger picture."""
    height, width = spec.height, spec.width
    half = max(spec.multiple_of, height // 2 // spec.multiple_of * spec.multiple_of)
    return (
        (1, height, width),
        (3, height, width),
        (1, width, height),
        (2, half, width),
        (1, 2 * height, 2 * width),
    )
