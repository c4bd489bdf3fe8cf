"""A card to start from, written from what an ONNX file says, with every guess named."""

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from depthcli.core.options import one_line
from depthcli.core.types import DepthKind
from depthcli.errors import ModelError, UsageError
from depthcli.inference.session import ort
from depthcli.io.guard import Guard
from depthcli.io.storage.atomic import atomic_path
from depthcli.models.card import SCHEMA, Colour, ModelCard
from depthcli.models.catalog import CARD_SUFFIX, onnx_facts

_IMAGENET = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
_USUAL_PX, _PATCH_PX = 518, 14  # of the networks with a vision transformer that people export
_MAX_M = 20.0
_IMAGE_RANK = 4
_KINDS = {DepthKind.INVERSE: "disp|inv", DepthKind.METRIC: "metric|metre|meter"}


class Answers(NamedTuple):
    """What the user states about a network; None for a guess."""

    kind: DepthKind | None = None  #: what its numbers mean
    colour: Colour | None = None  #: its channels
    mean: tuple[float, ...] | None = None  #: subtracted from colours in [0, 1]
    std: tuple[float, ...] | None = None  #: divisor after that
    output: str | None = None  #: name of the output that is the depth map


class NewCard(NamedTuple):
    """A card that was written."""

    path: Path  #: the file
    guesses: tuple[str, ...]  #: what to check, one line each


def new_card(model: Path, out: Path | None, answers: Answers, *, overwrite: bool) -> NewCard:
    """Write a card for an ONNX file, by default ``NAME.card.json`` beside it.

    UsageError if several outputs could be the depth map, ModelError if the file is no network of
    images.
    """
    facts, session = onnx_facts(model), _session(model)
    layout, channels, size_px = _image_shape(session.get_inputs(), model)
    output = _depth_output(session.get_outputs(), answers.output)
    guesses = list[str]()

    def guess(name: str, stated: Any, guessed: Any, why: str) -> Any:  # noqa: ANN401 - of an option
        if stated is not None:
            return stated
        text = ",".join(map(str, guessed)) if isinstance(guessed, tuple) else guessed
        guesses.append(f"{name} is {text}: {why}")
        return guessed

    words = f"{model.name} {output}".lower()
    by_name = next((kind for kind, word in _KINDS.items() if re.search(word, words)), None)
    why = "larger is nearer" if by_name in {None, DepthKind.INVERSE} else "by its name"
    kind = guess("output.kind", answers.kind, by_name or DepthKind.INVERSE, why)
    is_rgb, is_dynamic = channels == Colour.RGB.channels, None in size_px
    of_input = f"usual where an input has {channels} channels"
    colour = guess("input.colour", answers.colour, Colour.RGB if is_rgb else Colour.LUMA, of_input)
    mean, std = _IMAGENET if is_rgb else ((0.5,), (0.5,))
    spec = {
        "colour": colour,
        "width": size_px[1] or _USUAL_PX,
        "height": size_px[0] or _USUAL_PX,
        "dynamic": is_dynamic,
        "multiple_of": _PATCH_PX if is_dynamic else 1,
        "fit": "keep-aspect" if is_dynamic else "stretch",
        "mean": guess("input.mean", answers.mean, mean, of_input),
        "std": guess("input.std", answers.std, std, of_input),
        "layout": layout,
    }
    matrices = [entry.name for entry in session.get_inputs()[1:] if entry.shape[-2:] == [3, 3]]
    if matrices:
        spec["camera_matrix"] = guess("input.camera_matrix", None, matrices[-1], "by its shape")
    if is_dynamic:
        size = f"{_USUAL_PX}, and multiple_of {_PATCH_PX}"
        guesses.append(f"input.width and height are {size}: the file accepts any size")
    depth = {"kind": kind, "transform": "linear", "scale": 1.0, "shift": 0.0}
    if kind is DepthKind.METRIC:
        depth |= {"min_m": 0.0, "max_m": guess("output.max_m", None, _MAX_M, "depth is clipped")}
        guesses.append("camera is null: metres do not follow the focal length")
    fields = {
        "schema": SCHEMA,
        "name": re.sub(r"[^A-Za-z0-9._-]+", "-", model.stem).strip("-.") or "model",
        "version": "1.0.0",
        "summary": f"{model.name}, with a card that was guessed in part",
        "license": guess("license", None, "LicenseRef-unknown", "the file does not state it"),
        "input": spec,
        "output": depth,
        "camera": None,
        "onnx": {"opset": facts.opset, "ir": facts.ir, "output": output},
        "file": model.name,
    }
    text = ModelCard.from_json(json.dumps(fields), where="the new card").to_json()
    path = out or model.with_name(model.stem + CARD_SUFFIX)
    with atomic_path(path, guard=Guard.of([model], overwrite=overwrite)) as temporary:
        temporary.write_text(text, "utf-8")
    return NewCard(path, tuple(guesses))


def _session(model: Path) -> ort.InferenceSession:
    try:
        return ort.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    except Exception as error:
        reason = one_line(str(error))
        raise ModelError(f"onnxruntime cannot load {model}: {reason}") from error


def _image_shape(
    inputs: Sequence[Any], model: Path
) -> tuple[str, int, tuple[int | None, int | None]]:
    """Layout, channels, and height and width of the image's input; None where it is dynamic."""
    for entry in inputs:
        for layout, axis in (("nchw", 1), ("nhwc", 3)):
            if len(entry.shape) == _IMAGE_RANK and entry.shape[axis] in {1, 3}:
                sides = [side if isinstance(side, int) else None for side in entry.shape]
                channels = sides.pop(axis)
                return layout, channels or 1, (sides[1], sides[2])
    listed = ", ".join(f"{entry.name} {entry.shape}" for entry in inputs)
    raise ModelError(f"{model} has no input of an image of 1 or 3 channels, but {listed}")


def _depth_output(outputs: Sequence[Any], stated: str | None) -> str:
    names = [entry.name for entry in outputs]
    if stated in names or (stated is None and len(names) == 1):
        return stated or str(names[0])
    raise UsageError(
        f"the outputs are {', '.join(names)}", "name the depth map", option="depth_output"
    )
