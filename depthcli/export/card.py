"""Making the card of an exported model from its checkpoint."""

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from depthcli.core.choices import Weights
from depthcli.core.types import DepthKind
from depthcli.datasets import id_ranges
from depthcli.datasets.splits import NYU, TRAIN_IDS
from depthcli.errors import ModelError, UsageError
from depthcli.export.graph import IR_VERSION
from depthcli.export.options import ExportOptions
from depthcli.metrics.pixels import MIN_DEPTH_M
from depthcli.models.card import ModelCard
from depthcli.models.card_specs import CameraSpec, Colour, Fit, InputSpec, OnnxSpec, OutputSpec
from depthcli.models.locations import CARD_NAME, CARD_SUFFIX
from depthcli.training.checkpoint import Checkpoint
from depthcli.training.provenance import data_set

MODEL_NAME = "model.onnx"
_FULL_STRIDE = 4


def card_path(model: Path) -> Path:
    """The path of a model's card.

    That of ``model.onnx`` is ``card.json``; any other ``name.onnx`` may share its folder with other
    models and has ``name.card.json``.
    """
    return model.with_name(CARD_NAME if model.name == MODEL_NAME else model.stem + CARD_SUFFIX)


def card_of(saved: Checkpoint, options: ExportOptions) -> ModelCard:
    """The card of a checkpoint's generator, without the facts of the file.

    Raises:
        UsageError: the value of an option is not valid in a card, or contradicts the checkpoint.
    """
    config = saved.config
    codec = config.output.codec
    hfov_deg = _hfov_deg(options.hfov_deg, saved.provenance.hfov_deg)
    card = ModelCard(
        name=options.name,
        version=options.version,
        summary=f"{config.method}, {config.generator.name} generator, {saved.provenance.data}",
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
            pixel_aspect=round(saved.provenance.aspect * config.data.height / config.data.width, 9),
        ),
        output=OutputSpec(
            kind=DepthKind.METRIC,
            transform=codec.transform,
            scale=codec.scale,
            shift=codec.shift,
            min_m=config.output.min_m if config.output.coding == "log" else MIN_DEPTH_M,
            max_m=config.output.max_m,
        ),
        camera=None if hfov_deg is None else CameraSpec(hfov_deg),
        onnx=OnnxSpec(options.opset, IR_VERSION),
        training=_training_facts(saved, options),
        float_model=options.float_model,
    )
    try:
        return ModelCard.from_json(card.to_json())
    except ModelError as error:
        what, _, _ = str(error).partition(";")
        raise UsageError(f"{what}; correct the option") from error


def _hfov_deg(given: float | None, known: float | None) -> float | None:
    """The field of view of the training's camera, degrees; None if it is not known."""
    if given is not None and known is not None and given != known:
        # Depth from cameras.csv is already scaled to the known camera, whatever the true lens.
        raise UsageError(
            f"--hfov {given:g} contradicts the checkpoint, whose depth is that of a camera of "
            f"{known:g}°: remove --hfov"
        )
    return known if given is None else given


def _training_facts(saved: Checkpoint, options: ExportOptions) -> dict[str, Any]:
    state, provenance = saved.state, saved.provenance
    averaged = saved.ema_generator is None or options.weights is Weights.AVERAGED
    is_int8 = options.int8_pictures is not None
    precision = "int8" if is_int8 else "float16" if options.half else None
    seen = provenance.seen_ids
    is_new = set(provenance.held_out_ids).isdisjoint(seen.get(data_set(provenance.data), ()))
    # Parity keeps float16 near the weights that were validated; the others differ from them.
    validated = averaged and is_new and not (options.mirror or is_int8)
    return {
        "data": provenance.data,
        **({"pseudo_labels": provenance.pseudo_labels} if provenance.pseudo_labels else {}),
        **({"init_weights": provenance.init_weights} if provenance.init_weights else {}),
        "method": saved.config.method,
        "seed": saved.config.seed,
        "pairs": len(provenance.train_ids),
        "held_out_pairs": len(provenance.held_out_ids),
        **_nyu_pairs(seen),
        "steps": state.step,
        "minutes": round(state.seconds / 60, 1),
        "validation": {
            name: round(value, 4)
            for name, value in state.scores.items()
            if validated and math.isfinite(value)
        },
        **({} if averaged else {"weights": str(Weights.RAW)}),
        **({"precision": precision} if precision else {}),
        **({"mirror": True} if options.mirror else {}),
        "config": json.loads(json.dumps(dataclasses.asdict(saved.config))),
    }


def _nyu_pairs(seen: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Ids of the pairs of NYU Depth v2 that its weights have seen, for evaluations of the model."""
    ids = seen.get(NYU)
    return {TRAIN_IDS: id_ranges.compact(i for i in ids if i.isdecimal())} if ids else {}
