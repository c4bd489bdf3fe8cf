"""A checkpoint to a model folder: one ONNX file and its card, gated by parity."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from depthcli.core.choices import Weights
from depthcli.core.types import DepthKind
from depthcli.datasets import id_ranges
from depthcli.export.graph import (
    IR_VERSION,
    OPSET,
    MirrorAverage,
    build_graph,
    folded,
    halve_weights,
    set_metadata,
)
from depthcli.export.int8 import calibration_batches, quantize
from depthcli.export.parity import HALF_TOLERANCE, INT8_TOLERANCE, TOLERANCE, Parity, check_parity
from depthcli.io.storage.atomic import atomic_path
from depthcli.models.card import METADATA_KEY, ModelCard
from depthcli.models.card_specs import CameraSpec, Colour, Fit, InputSpec, OnnxSpec, OutputSpec
from depthcli.models.catalog import CARD_NAME
from depthcli.training.checkpoint import Checkpoint, Progress, load_generator

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    import numpy.typing as npt

MODEL_NAME = "model.onnx"
NO_LICENSE = "NOASSERTION"
"""What SPDX writes where nobody has said under which licence something is."""
_CARD_SUFFIX = f".{CARD_NAME}"
_FULL_STRIDE = 4


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """What is exported.

    Attributes:
        name: of the model.
        version: of the model.
        half: store weights as float16; sums stay float32.
        mirror: average with the mirrored picture, at twice the cost.
        opset: ONNX operator set.
        tolerance: largest difference between torch and onnxruntime; None for the usual one.
        int8_pictures: folder of pictures to calibrate int8 on; None keeps floats.
        license: of the weights, an SPDX name.
        hfov_deg: horizontal field of view of the camera that took the training pictures, degrees;
            None for what the checkpoint knows of it.
        weights: the average, where the run keeps one, or those of the last step.
    """

    name: str = "custom"
    version: str = "1.0.0"
    half: bool = False
    mirror: bool = False
    opset: int = OPSET
    tolerance: float | None = None
    int8_pictures: Path | None = None
    license: str = NO_LICENSE
    hfov_deg: float | None = None
    weights: Weights = Weights.AVERAGED

    @property
    def allowed(self) -> float:
        """Largest difference that parity lets pass."""
        if self.tolerance is not None:
            return self.tolerance
        if self.int8_pictures is not None:
            return INT8_TOLERANCE
        return HALF_TOLERANCE if self.half else TOLERANCE


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written.

    Attributes:
        path: the ONNX file.
        card: its card, written beside it.
        parity: how close it is to torch.
    """

    path: Path
    card: ModelCard
    parity: Parity


def export_checkpoint(checkpoint: Path, out: Path, options: ExportOptions) -> Exported:
    """Export the generator of a checkpoint.

    Args:
        checkpoint: written by training.
        out: the ONNX file; its card is written beside it, see :func:`card_path`.
        options: what to export.

    Raises:
        CheckpointError: the checkpoint cannot be used.
        ParityError: the result is not the network; nothing is written.
        OutputError: a file cannot be written.
    """
    generator, saved = load_generator(checkpoint, options.weights)
    model = build_graph(generator, opset=options.opset, mirror=options.mirror)
    card = card_of(saved, options)
    pictures: list[npt.NDArray[np.float32]] = []
    if options.int8_pictures is not None:
        pictures = calibration_batches(options.int8_pictures, card.input)
        model = quantize(model, pictures)
    elif options.half:
        halve_weights(model)
    set_metadata(model, {METADATA_KEY: card.to_json()})
    data = model.SerializeToString()
    network = MirrorAverage(folded(generator)) if options.mirror else generator
    cases = _cases(card.input)[: 1 if pictures else None]
    parity = check_parity(network, data, cases, options.allowed, pictures)
    card = dataclasses.replace(
        card,
        file=out.name,
        sha256=hashlib.sha256(data).hexdigest(),
        size_bytes=len(data),
    )
    with atomic_path(out, inputs=[checkpoint]) as path:
        path.write_bytes(data)
    with atomic_path(card_path(out), inputs=[checkpoint]) as path:
        path.write_text(card.to_json(), "utf-8")
    return Exported(out, card, parity)


def card_path(model: Path) -> Path:
    """Where a model's card belongs.

    ``model.onnx`` has a folder to itself and ``card.json`` in it; any other ``name.onnx`` shares
    its folder with other models and has ``name.card.json``.
    """
    return model.with_name(CARD_NAME if model.name == MODEL_NAME else model.stem + _CARD_SUFFIX)


def card_of(saved: Checkpoint, options: ExportOptions) -> ModelCard:
    """The card of a checkpoint's generator, without what depends on the file."""
    config = saved.config
    codec = config.output.codec
    hfov_deg = options.hfov_deg or saved.progress.hfov_deg
    return ModelCard(
        name=options.name,
        version=options.version,
        summary=f"{config.method}, {config.generator.name} generator, {saved.progress.data}",
        license=options.license,
        input=InputSpec(
            colour=Colour(config.data.colour),
            width=config.data.width,
            height=config.data.height,
            dynamic=True,
            multiple_of=_FULL_STRIDE,
            fit=Fit.KEEP_ASPECT,
            mean=(0.5,),
            std=(0.5,),
            pixel_aspect=round(saved.progress.aspect * config.data.height / config.data.width, 9),
        ),
        output=OutputSpec(
            kind=DepthKind.METRIC,
            transform=codec.transform,
            scale=codec.scale,
            shift=codec.shift,
            min_m=config.output.min_m,
            max_m=config.output.max_m,
        ),
        camera=None if hfov_deg is None else CameraSpec(hfov_deg),
        onnx=OnnxSpec(options.opset, IR_VERSION),
        training=_training(saved),
    )


def _training(saved: Checkpoint) -> dict[str, Any]:
    progress = saved.progress
    return {
        "data": progress.data,
        **({"extra": progress.extra} if progress.extra else {}),
        **({"start": progress.start} if progress.start else {}),
        "method": saved.config.method,
        "seed": saved.config.seed,
        "pairs": len(progress.train_ids),
        "held_out_pairs": len(progress.held_out_ids),
        **_nyu_pairs(progress),
        "steps": progress.step,
        "minutes": round(progress.seconds / 60, 1),
        "validation": {
            name: round(value, 4) for name, value in progress.scores.items() if math.isfinite(value)
        },
        "config": json.loads(json.dumps(dataclasses.asdict(saved.config))),
    }


def _nyu_pairs(progress: Progress) -> dict[str, str]:
    """Ids of NYU Depth v2 that were trained on, for whoever evaluates the model."""
    if not progress.data.startswith("NYU Depth v2"):
        return {}
    return {"nyu_train_ids": id_ranges.written(i for i in progress.train_ids if i.isdecimal())}


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
