"""Exporting a checkpoint to an ONNX file and its card, after a parity check."""

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from onnx import helper

from depthcli.core.types import DepthKind
from depthcli.errors import ModelError, UsageError
from depthcli.io.guard import Guard
from depthcli.io.storage.atomic import atomic_path
from depthcli.lab.datasets import base as datasets
from depthcli.lab.export import graph, int8
from depthcli.lab.metrics.depth import MIN_DEPTH_M
from depthcli.lab.options import Weights
from depthcli.lab.training.checkpoint import CHECKPOINT, Checkpoint, load_generator
from depthcli.lab.training.provenance import TrainedRun, common_ids
from depthcli.models import card as cards, catalog
from depthcli.models.card import ModelCard

MODEL_NAME = "model.onnx"
_FULL_STRIDE = 4


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Options of an export."""

    name: str = "custom"  #: of the model
    model_version: str = "1.0.0"  #: of the model
    fp16: bool = False  #: store weights as float16; computations are in float32
    int8: Path | None = None  #: folder of images to calibrate int8; None for no int8
    opset: int = graph.OPSET  #: ONNX opset version
    #: maximum difference between torch and onnxruntime; None for the default
    tolerance: float | None = None
    license_name: str = "NOASSERTION"  #: of the weights, an SPDX identifier
    #: horizontal field of view of the training images, degrees; None for that of the checkpoint
    hfov: float | None = None
    depth_factor: float = 1.0  #: on depth, which corrects a bias that was measured
    focal_exponent: float = 1.0  #: of the card's camera
    float_model: str | None = None  #: name of the model that replaces an int8 one off the CPU
    #: the moving average, if the run has one, or the weights of the last step
    weights: Weights = Weights.AVERAGED

    @property
    def max_difference(self) -> float:
        """Maximum difference that the parity check accepts."""
        if self.tolerance is not None:
            return self.tolerance
        tolerance = graph.FLOAT16_TOLERANCE if self.fp16 else graph.TOLERANCE
        return tolerance if self.int8 is None else graph.INT8_TOLERANCE


def card_path(model: Path) -> Path:
    """The card of ``model.onnx`` is ``card.json``; ``name.onnx`` has ``name.card.json``."""
    is_alone = model.name == MODEL_NAME
    return model.with_name(catalog.CARD_NAME if is_alone else model.stem + catalog.CARD_SUFFIX)


def card_of(saved: Checkpoint, options: ExportOptions) -> ModelCard:
    """The card of a checkpoint's generator, without the facts of the file."""
    config, data, output = saved.config, saved.config.data, saved.config.output
    codec = output.codec.times(options.depth_factor)
    run_deg = saved.provenance.hfov_deg
    hfov_deg = run_deg if options.hfov is None else options.hfov
    if run_deg not in (hfov_deg, None):
        # Depth from cameras.csv is already scaled to the known camera, whatever the true lens.
        message = f"contradicts the checkpoint, whose depth is that of a camera of {run_deg:g}°"
        raise UsageError(f"{hfov_deg:g}° {message}", option="hfov_deg")
    half = (0.5,) * data.channels
    min_m = output.min_m if output.coding == "log" else MIN_DEPTH_M
    card = ModelCard(
        name=options.name,
        version=options.model_version,
        summary=f"{config.method}, {config.generator.name} generator, {saved.provenance.data}",
        license=options.license_name,
        input=cards.InputSpec(
            colour=cards.Colour(data.colour),
            width=data.width,
            height=data.height,
            dynamic=True,
            multiple_of=_FULL_STRIDE,
            fit=cards.Fit.KEEP_ASPECT,
            mean=half,
            std=half,
            prompt=bool(config.generator.prompt),
            pixel_aspect=round(saved.provenance.aspect * data.height / data.width, 9),
        ),
        output=cards.OutputSpec(
            DepthKind.METRIC, codec.transform, codec.scale, codec.shift, min_m, output.max_m
        ),
        camera=None
        if hfov_deg is None
        else cards.CameraSpec(hfov_deg, exponent=options.focal_exponent),
        onnx=cards.OnnxSpec(options.opset, graph.IR_VERSION),
        training=_training_facts(saved, options),
        float_model=options.float_model,
    )
    try:
        return ModelCard.from_json(card.to_json())
    except ModelError as error:
        what, _, _ = str(error).partition(";")
        raise UsageError(f"{what}; correct the option") from error


def _training_facts(saved: Checkpoint, options: ExportOptions) -> dict[str, Any]:
    state, provenance = saved.state, saved.provenance
    averaged = saved.ema_generator is None or options.weights is Weights.AVERAGED
    is_int8, is_corrected = options.int8 is not None, options.depth_factor != 1
    nyu = provenance.seen_ids.get(datasets.NYU, ())
    repeated = common_ids(provenance.data, provenance.held_out_ids, provenance.seen_ids)
    # Parity keeps float16 near the weights that were validated; the others differ from them.
    validated = averaged and not (repeated or is_int8 or is_corrected)
    facts = {
        "data": provenance.data,
        "pseudo_labels": provenance.pseudo_labels or None,
        "init_weights": provenance.init_weights or None,
        "encoder_weights": provenance.encoder_weights or None,
        "method": saved.config.method,
        "seed": saved.config.seed,
        "pairs": len(provenance.train_ids),
        "held_out_pairs": len(provenance.held_out_ids),
        datasets.TRAIN_IDS: datasets.compact(i for i in nyu if i.isdecimal()) if nyu else None,
        "steps": state.step,
        "minutes": round(state.seconds / 60, 1),
        "validation": {
            name: round(value, 4)
            for name, value in state.scores.items()
            if validated and math.isfinite(value)
        },
        "weights": None if averaged else str(Weights.RAW),
        "depth_factor": options.depth_factor if is_corrected else None,
        "precision": "int8" if is_int8 else "float16" if options.fp16 else None,
        "config": json.loads(json.dumps(dataclasses.asdict(saved.config))),
    }
    return {name: value for name, value in facts.items() if value is not None}


@dataclass(frozen=True, slots=True)
class ExportResult:
    """The result of an export."""

    path: Path  #: the ONNX file
    card: ModelCard  #: its card, written beside it
    parity: graph.Parity  #: difference from torch


def export_checkpoint(checkpoint: Path, out: Path, options: ExportOptions) -> ExportResult:
    """Export the generator of a checkpoint to an ONNX file, with its card beside it."""
    own_card = card_path(out)
    if own_card.is_file() and catalog.files_of_card(own_card)[:1] != [out.name]:
        raise UsageError(f"{own_card} is not the card of {out.name}; choose another -o")
    generator, saved = load_generator(checkpoint, options.weights)
    model = graph.build_graph(generator, opset=options.opset)
    card = card_of(saved, options)
    folder = options.int8
    images = [] if folder is None else int8.calibration_batches(folder, card.input)
    if images:
        model = int8.quantize(model, images, generator)
    elif options.fp16:
        graph.weights_to_float16(model)
    helper.set_model_props(model, {cards.METADATA_KEY: card.to_json()})
    data = model.SerializeToString()
    # Nominal size, a batch, other aspect ratios, a larger size.
    height, width, step = card.input.height, card.input.width, card.input.multiple_of
    half, twice = max(step, height // 2 // step * step), (1, 2 * height, 2 * width)
    others = (3, height, width), (1, width, height), (2, half, width), twice
    cases = (1, height, width), *(() if images else others)
    parity = graph.check_parity(generator, data, cases, options.max_difference, images)
    card = dataclasses.replace(
        card, file=out.name, sha256=hashlib.sha256(data).hexdigest(), size_bytes=len(data)
    )
    Guard.of([checkpoint], overwrite=True).check(out, own_card)
    # Both are written before either is renamed, as old and new ones do not match.
    with atomic_path(out) as path, atomic_path(own_card) as card_file:
        path.write_bytes(data)
        card_file.write_text(card.to_json(), "utf-8")
    return ExportResult(out, card, parity)


def find_runs(folder: Path) -> tuple[Path, ...]:
    """The folder itself or its subfolders that have a checkpoint, sorted by name."""
    if (folder / CHECKPOINT).is_file():
        return (folder,)
    runs = tuple(sorted(path.parent for path in folder.glob(f"*/{CHECKPOINT}")))
    if not runs:
        raise UsageError(f"{folder} holds no run of 'depthcli train'")
    return runs


def open_run(folder: Path) -> TrainedRun:
    """Facts about a run from its checkpoint."""
    generator, saved = load_generator(folder / CHECKPOINT)
    parameters = sum(weights.numel() for weights in generator.parameters())
    return TrainedRun(folder, saved.config, saved.state, saved.provenance, parameters)


def export_run(run: TrainedRun, folder: Path, weights: Weights = Weights.AVERAGED) -> Path:
    """Export a run's model into a folder, and return the path of its file."""
    options = ExportOptions(name=run.name, weights=weights)
    return export_checkpoint(run.folder / CHECKPOINT, folder / f"{run.name}.onnx", options).path
