"""A model's card: everything that is needed to run the model, so that new models need no code."""

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from depthcli.core.camera import HFOV_DEG
from depthcli.core.options import Rule, short_repr
from depthcli.core.types import DepthCodec, DepthKind, Transform
from depthcli.core.validation import FieldError, parsed_json, validated
from depthcli.errors import ModelError

MAX_INPUT_PIXELS = 2**24
"""With more, the first layers of a network take more memory than machines have."""
_MAX_SIDE = 2**15
_Side: TypeAlias = Annotated[
    int, Rule(f"a whole number from 1 to {_MAX_SIDE}", lambda px: 1 <= px <= _MAX_SIDE)
]
Text: TypeAlias = Annotated[
    str, Rule("printable text", lambda text: text.isprintable() and bool(text.strip()))
]
Count: TypeAlias = Annotated[int, Rule("a whole number from 1 up", lambda number: number >= 1)]
_Factor: TypeAlias = Annotated[float, Rule("a number other than 0", bool)]
_Ratio: TypeAlias = Annotated[float, Rule("a number above 0", lambda number: number > 0)]


class Colour(StrEnum):
    """The colours that a network takes."""

    VALUE = "value"
    """V of HSV, the largest of R, G and B."""
    LUMA = "luma"
    """Weighted sum of R, G and B."""
    RGB = "rgb"

    @property
    def channels(self) -> int:
        """Planes of the network's input."""
        return 3 if self is Colour.RGB else 1


class Fit(StrEnum):
    """Fitting of an image to the network's size."""

    STRETCH = "stretch"
    """To width x height, without keeping the aspect."""
    KEEP_ASPECT = "keep-aspect"
    """The picture's aspect is kept: same pixel count if the size is dynamic, else a letterbox.

    A dynamic size is no longer than 2 : 1; longer pictures are padded to that.
    """
    LOWER_BOUND = "lower-bound"
    """Dynamic only: the aspect is kept, and neither side is below the nominal size."""
    UPPER_BOUND = "upper-bound"
    """Dynamic only: the aspect is kept, and neither side is above the nominal size."""


class Resize(StrEnum):
    """Resizing of an image to the network's input."""

    AREA = "area"
    """Mean over each output pixel's area when shrinking, bilinear when enlarging."""
    LINEAR = "linear"
    """Bilinear, half-pixel centres, no antialiasing."""
    CUBIC = "cubic"
    """Bicubic (a = -0.75), half-pixel centres, no antialiasing: OpenCV's INTER_CUBIC."""


class TensorLayout(StrEnum):
    """Order of the axes of the network's input."""

    NCHW = "nchw"
    """Picture, channel, row, column."""
    NHWC = "nhwc"
    """Picture, row, column, channel, the default of TensorFlow's converters."""


@dataclass(frozen=True, slots=True)
class InputSpec:
    """The network's input, float32: ``(colour in [0, 1] - mean) / std``."""

    colour: Colour  #: the channels
    width: _Side  #: columns in pixels; the nominal size where it is dynamic
    height: _Side  #: rows in pixels
    dynamic: bool  #: whether any multiple of ``multiple_of`` is a valid width and height
    multiple_of: _Side  #: granularity of a dynamic size, in pixels
    fit: Fit  #: how the picture is fitted to this size
    mean: tuple[float, ...]  #: one number a channel, or one for all
    std: tuple[_Ratio, ...]  #: one number a channel, or one for all
    resize: Resize = Resize.AREA  #: how the picture is resized
    layout: TensorLayout = TensorLayout.NCHW  #: order of the axes
    #: width over height of the network's pixels as it learned them, in pixels of the picture: 4/3
    #: if it learned pictures of 4:3 stretched to a square. For ``stretch`` and ``keep-aspect``
    pixel_aspect: _Ratio = 1.0
    #: whether known depth, coded as the output, and its mask are further inputs of this size, with
    #: the names of ``PROMPT_INPUTS`` and one channel each
    prompt: bool = False


PROMPT_INPUTS = "prompt", "mask"
"""Names of the inputs for known depth and for its mask, 1 where it is known and 0 elsewhere."""


@dataclass(frozen=True, slots=True)
class OutputSpec:
    """The meaning of the network's raw output; see :class:`DepthCodec`."""

    kind: DepthKind  #: metric, relative or inverse
    transform: Transform  #: how depth follows from ``scale * raw + shift``
    scale: _Factor  #: factor on the raw output
    shift: float  #: added after the factor
    min_m: float | None = None  #: least depth in metres; None if the kind is not metric
    max_m: _Ratio | None = None  #: largest depth in metres; None if the kind is not metric

    @property
    def codec(self) -> DepthCodec:
        """The mapping from raw output to depth."""
        return DepthCodec(self.transform, self.scale, self.shift)


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """The camera that the model was trained on."""

    #: horizontal field of view over the full picture width, in degrees
    hfov_deg: Annotated[float, HFOV_DEG]


@dataclass(frozen=True, slots=True)
class OnnxSpec:
    """Versions that decide which onnxruntime can load the file, and which output is the map."""

    opset: Count
    ir: Count
    output: Text | None = None  #: name of the output that is the depth map; None for the only one


_Address: TypeAlias = Annotated[
    str,
    Rule("an address: https://host/name", re.compile(r"https?://[!-~]+").fullmatch),
]
_Sha256: TypeAlias = Annotated[str, Rule("64 hex digits", re.compile(r"[0-9a-f]{64}").fullmatch)]


@dataclass(frozen=True, slots=True)
class WeightsSpec:
    """Where a model's weights are published; nothing is downloaded unless it is asked for."""

    page: _Address  #: the authors' page of the weights, for people
    url: _Address | None = None  #: of an ONNX file, which ``models add`` downloads; None if none is
    size_bytes: Count | None = None  #: size of that file (``bytes`` in JSON)
    sha256: _Sha256 | None = None  #: published checksum of that file, 64 hex digits
    source: Text | None = None  #: where its address, size and checksum are published
    export: Text | None = None  #: command that makes an ONNX file of the authors' weights


SCHEMA = 1
METADATA_KEY = "depthcli.card"
"""Key of the ONNX metadata under which a model carries its own card."""
_OPTIONAL_INPUT = {
    "resize": Resize.AREA,
    "layout": TensorLayout.NCHW,
    "pixel_aspect": 1.0,
    "prompt": False,
}
_UNPRINTABLE = "[\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
_BOUNDS = frozenset({Fit.LOWER_BOUND, Fit.UPPER_BOUND})
_FileName: TypeAlias = Annotated[
    str,  # a card never points outside its own folder
    Rule(
        "a file name without a folder",
        re.compile(r"(?!\.\.?$)[^/\\:\0\ud800-\udfff]{1,255}").fullmatch,
    ),
]
_ModelName: TypeAlias = Annotated[
    str,  # nor anywhere but among the models by name
    Rule("a model's name", re.compile(r"(?!.*\.onnx$)[A-Za-z0-9][A-Za-z0-9._-]{0,99}").fullmatch),
]


@dataclass(frozen=True, slots=True)
class ModelCard:
    """One model, as written in its ``card.json`` or inside its ONNX file.

    Attributes:
        name: the name for ``--model``.
        version: of the weights.
        summary: one line.
        license: SPDX name.
        input: the network's input.
        output: the meaning of its output.
        camera: the camera it learned; None leaves metres unscaled.
        onnx: opset and IR version, and the output that is the depth map.
        file: name of the ONNX file beside the card; None in an embedded card.
        sha256: checksum of that file, 64 hex digits; None in an embedded card.
        size_bytes: size of that file (``bytes`` in JSON); None in an embedded card.
        float_model: the same network in floats, which replaces this one on other providers than
            the CPU; None if there is none.
        weights: where the weights are published; None if the card does not say.
        training: how it was trained; any JSON object.
        scores: its scores by protocol; any JSON object.
        latency: its latency by machine; any JSON object.
    """

    name: Text
    version: Text
    summary: Text
    license: Text
    input: InputSpec
    output: OutputSpec
    camera: CameraSpec | None
    onnx: OnnxSpec
    file: _FileName | None = None
    sha256: _Sha256 | None = None
    size_bytes: Count | None = None
    float_model: _ModelName | None = None
    weights: WeightsSpec | None = None
    training: Mapping[str, Any] = field(default_factory=dict)
    scores: Mapping[str, Any] = field(default_factory=dict)
    latency: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def from_json(cls, text: str | bytes, *, where: str = "card") -> "ModelCard":
        """Read a card's JSON, which messages call ``where``.

        Raises:
            ModelError: not JSON, or a field is missing, unknown, ill-typed or out of range.
        """
        try:
            parsed = parsed_json(text)
            if not isinstance(parsed, dict):
                raise FieldError.expected("a JSON object", parsed)
            schema = parsed.pop("schema", None)
            if schema != SCHEMA or schema is True:
                told = f"has schema {short_repr(schema)}, this depthcli reads {SCHEMA}: upgrade it"
                raise FieldError(told)  # noqa: TRY301 - as those of its fields
            for file in (parsed, parsed.get("weights")):
                _read_file_facts(file)
            card = validated(cls, parsed)
            _check_input(card.input)
            _check_output(card.output)
            _check_prompt(card)
        except FieldError as refused:
            raise ModelError(f"{where}: {refused}; correct the card or restore the model") from None
        return card

    def to_json(self) -> str:
        """The card as JSON text, readable by :meth:`from_json`."""
        values = asdict(self)
        for group in filter(None, (values, values["weights"])):
            group["bytes"] = group.pop("size_bytes")
        for name in ("file", "sha256", "bytes", "float_model", "weights"):
            if values[name] is None:
                del values[name]
        if self.weights is not None:
            stated = values["weights"].items()
            values["weights"] = {name: value for name, value in stated if value is not None}
        if self.onnx.output is None:
            del values["onnx"]["output"]
        for name in ("mean", "std"):
            values["input"][name] = list(values["input"][name])
        for name, default in _OPTIONAL_INPUT.items():
            if values["input"][name] == default:  # cards without it stay readable everywhere
                del values["input"][name]
        text = json.dumps(
            {"schema": SCHEMA, **values}, indent=2, ensure_ascii=False, allow_nan=False
        )
        # JSON escapes only the first 32 control characters; terminals interpret others, too.
        return re.sub(_UNPRINTABLE, lambda found: f"\\u{ord(found[0]):04x}", text) + "\n"


def _read_file_facts(values: object) -> None:
    """Bring size and checksum of a JSON object about a file into the form of the fields."""
    if not isinstance(values, dict):
        return
    if "bytes" in values:
        values["size_bytes"] = values.pop("bytes")
    if isinstance(values.get("sha256"), str):
        values["sha256"] = values["sha256"].lower()


def _check_input(spec: InputSpec) -> None:
    """Check fields that depend on each other."""
    for name, numbers in (("mean", spec.mean), ("std", spec.std)):
        if len(numbers) not in {1, spec.colour.channels}:
            raise FieldError("has to be one number, or one a channel", f"input.{name}")
    if spec.width * spec.height > MAX_INPUT_PIXELS:
        raise FieldError(f"times height is more than {MAX_INPUT_PIXELS:,} pixels", "input.width")
    if spec.dynamic and spec.multiple_of > min(spec.width, spec.height):
        raise FieldError("is more than input.width or input.height", "input.multiple_of")
    if spec.prompt and spec.layout is not TensorLayout.NCHW:
        raise FieldError(f"has to be {TensorLayout.NCHW} with a prompt", "input.layout")
    if spec.fit in _BOUNDS and not spec.dynamic:
        raise FieldError(f"is {spec.fit}, which needs a dynamic size", "input.fit")
    if spec.fit in _BOUNDS and spec.pixel_aspect != 1:
        raise FieldError(f"has to be 1 with a fit of {spec.fit}", "input.pixel_aspect")


def _check_prompt(card: "ModelCard") -> None:
    """Check that known depth can be coded as the output."""
    if card.input.prompt and card.output.transform is not Transform.EXP:
        raise FieldError(f"has to be {Transform.EXP} with a prompt", "output.transform")


def _check_output(spec: OutputSpec) -> None:
    """Check fields that depend on each other."""
    for name, metres in (("min_m", spec.min_m), ("max_m", spec.max_m)):
        if metres is None and spec.kind is DepthKind.METRIC:
            raise FieldError("has to be a number, as the kind is metric", f"output.{name}")
    if spec.min_m is not None and spec.max_m is not None and not 0 <= spec.min_m < spec.max_m:
        raise FieldError("has to be at least 0 and below max_m", "output.min_m")


_ALIGN = {
    DepthKind.METRIC: "",
    DepthKind.RELATIVE: " --align depth",
    DepthKind.INVERSE: " --align disparity",
}


@dataclass(frozen=True, slots=True)
class PreprocessingCheck:
    """Verification of a card's size, colours, mean and deviation."""

    #: whether the real weights were run with them on pictures of known depth
    run_with_weights: bool
    verified: str  #: how, one sentence


def preprocessing_check(card: ModelCard) -> PreprocessingCheck | None:
    """The check that a card states under ``training``; None if it states none."""
    try:
        return validated(PreprocessingCheck, card.training.get("preprocessing"))
    except FieldError:
        return None


def check_command(card: ModelCard) -> str:
    """The command that compares a model with known depth on a few pictures."""
    return (
        f"depthcli eval nyu --data NYU --split val --limit 20 --model {card.name}"
        + (_ALIGN[card.output.kind])
    )


def fit_to_graph(
    card: ModelCard, fixed_size: tuple[int | None, int | None], path: Path, *, adapt: bool
) -> ModelCard:
    """Compare a card with the input's (height, width) in the graph; None where that is dynamic.

    With ``adapt`` the graph's size replaces the card's, for networks that are exported at several
    sizes. Pictures are then stretched to it if the card has a dynamic size.

    Raises:
        ModelError: the card states another size.
    """
    spec = card.input
    height, width = fixed_size[0] or spec.height, fixed_size[1] or spec.width
    same = (height, width) == (spec.height, spec.width)
    if fixed_size == (None, None) or (same and (not spec.dynamic or spec.fit is Fit.STRETCH)):
        return card
    if not adapt:
        raise ModelError(
            f"{path} takes pictures of {width} x {height} pixels only; set input.width to {width}, "
            f"input.height to {height} and input.dynamic to false in the card"
        )
    pixel_aspect = spec.pixel_aspect
    if spec.fit is Fit.STRETCH:  # the aspect of the training pictures is the same
        pixel_aspect *= (spec.width * height) / (spec.height * width)
    return replace(
        card,
        input=replace(
            spec,
            width=width,
            height=height,
            dynamic=False,
            fit=Fit.STRETCH if spec.fit in _BOUNDS else spec.fit,
            pixel_aspect=pixel_aspect,
        ),
    )
