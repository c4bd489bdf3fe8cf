"""A model's card: everything that is needed to run the model, so that new models need no code."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from depthcli.core.camera import HFOV_DEG, focal_px_of_hfov
from depthcli.core.options import Rule, short_repr
from depthcli.core.types import DepthCodec, DepthKind, Transform
from depthcli.core.validation import FieldError, parsed_json, validated
from depthcli.errors import ModelError

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
    """The image's aspect is kept: same pixel count if the size is dynamic, else a letterbox.

    A dynamic size is no longer than 2 : 1; longer images are padded to that.
    """
    LOWER_BOUND = "lower-bound"
    """Dynamic only: the aspect is kept, and neither side is below the nominal size."""
    UPPER_BOUND = "upper-bound"
    """Dynamic only: the aspect is kept, and neither side is above the nominal size."""
    MINIMAL = "minimal"
    """Dynamic only: the aspect is kept, and of the nominal sides the one that scales less fits."""
    LONGEST_SIDE = "longest-side"
    """Dynamic only: the longest side is ``width``; each is then resized to a multiple again."""
    OWN_SIZE = "own-size"
    """Dynamic only: the image's own, down to a multiple."""


class Resize(StrEnum):
    """Resizing of an image to the network's input."""

    AREA = "area"
    """Mean over each output pixel's area when shrinking, bilinear when enlarging."""
    LINEAR = "linear"
    """Bilinear, half-pixel centres, no antialiasing."""
    CUBIC = "cubic"
    """Bicubic (a = -0.75), half-pixel centres, no antialiasing: OpenCV's INTER_CUBIC."""
    AREA_CUBIC = "area-cubic"
    """OpenCV's INTER_AREA if both sides shrink, else its INTER_CUBIC."""
    LINEAR_CORNERS = "linear-corners"
    """Bilinear, from corner pixel to corner pixel: torch's align_corners."""
    LINEAR_ANTIALIAS = "linear-antialias"
    """Bilinear, antialiased: Pillow's BILINEAR."""
    CUBIC_ANTIALIAS = "cubic-antialias"
    """Bicubic (a = -0.5), antialiased: Pillow's BICUBIC."""


_ENLARGING = frozenset({Resize.LINEAR, Resize.LINEAR_CORNERS, Resize.CUBIC})
_Enlarging: TypeAlias = Annotated[
    Resize, Rule("linear, linear-corners or cubic", _ENLARGING.__contains__)
]


@dataclass(frozen=True, slots=True)
class KnownDepthSpec:
    """A further input of known depth in metres everywhere, (N, 1, height, width)."""

    input: Text  #: name of that input
    width: _Side  #: its columns, of the whole image
    height: _Side  #: its rows


@dataclass(frozen=True, slots=True)
class InputSpec:
    """The network's input, float32: ``(colour in [0, 1] - mean) / std``."""

    colour: Colour  #: the channels
    width: _Side  #: columns in pixels; the nominal size where it is dynamic
    height: _Side  #: rows in pixels
    dynamic: bool  #: whether any multiple of ``multiple_of`` is a valid width and height
    multiple_of: _Side  #: granularity of a dynamic size, in pixels
    fit: Fit  #: how the image is fitted to this size
    mean: tuple[float, ...]  #: one number a channel, or one for all
    std: tuple[_Ratio, ...]  #: one number a channel, or one for all
    resize: Resize = Resize.AREA  #: how the image is resized
    #: whether each resizing rounds colours to 8 bits, as that of an 8-bit image does
    eight_bit: bool = False
    #: order of the axes: image, channel, row, column; channels are last in most of TensorFlow's
    layout: Literal["nchw", "nhwc"] = "nchw"
    #: width over height of the network's pixels as it learned them, in pixels of the image: 4/3
    #: if it learned images of 4:3 stretched to a square. For ``stretch`` and ``keep-aspect``
    pixel_aspect: _Ratio = 1.0
    #: whether known depth, coded as the output, and its mask are further inputs of this size, with
    #: the names of ``PROMPT_INPUTS`` and one channel each
    prompt: bool = False
    known_depth: KnownDepthSpec | None = None  #: of a network that needs a whole map of it
    #: name of the last input if it is the camera matrix, (N, 3, 3), in the network's pixels
    camera_matrix: Text | None = None

    @property
    def prompt_inputs(self) -> tuple[str, ...]:
        """Names of the inputs for known depth, in their order."""
        if self.known_depth is not None:
            return (self.known_depth.input,)
        return PROMPT_INPUTS if self.prompt else ()


PROMPT_INPUTS = "prompt", "mask"
"""Names of the inputs for known depth and for its mask, 1 where it is known and 0 elsewhere."""


@dataclass(frozen=True, slots=True)
class MaskSpec:
    """A second output of the network, of its map's size: which pixels have a depth."""

    output: Text  #: name of the output
    threshold: float  #: between pixels with depth and those without
    depth_is: Literal["above", "below"]  #: the side of pixels with depth


@dataclass(frozen=True, slots=True)
class PointsSpec:
    """A map of points, from which depth and the field of view follow by least squares."""

    scale_output: Text | None = None  #: name of the output that points are multiplied by, (N,)


@dataclass(frozen=True, slots=True)
class OutputSpec:
    """The meaning of the network's raw output; see :class:`DepthCodec`."""

    kind: DepthKind  #: metric, relative or inverse
    transform: Transform  #: how depth follows from ``scale * raw + shift``
    scale: _Factor  #: factor on the raw output
    shift: float  #: added after the factor
    min_m: float | None = None  #: least depth in metres; None if the kind is not metric
    max_m: _Ratio | None = None  #: largest depth in metres; None if the kind is not metric
    #: how the authors enlarge the raw output to the image's size
    enlarging: _Enlarging = Resize.LINEAR
    #: the map is (N, h, w, 3), x, y and z up to a shift of z; None for a map of depth
    points: PointsSpec | None = None
    mask: MaskSpec | None = None  #: the pixels that have a depth; None if the network gives none

    @property
    def codec(self) -> DepthCodec:
        """The mapping from raw output to depth."""
        return DepthCodec(self.transform, self.scale, self.shift)


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """The camera that a model's metres are for: a field of view or a focal length."""

    #: horizontal field of view over the full image width, in degrees
    hfov_deg: Annotated[float, HFOV_DEG] | None = None
    focal_px: _Ratio | None = None  #: focal length in pixels of the network's input
    #: where resizing stretches, the axis that counts; of both, the geometric mean, or the mean
    along: Literal["both", "mean", "width"] = "both"
    #: power of the ratio of focal lengths that metres are multiplied by: below 1 of a network that
    #: reacts to a part of a change in apparent size
    exponent: _Ratio = 1.0
    #: name of the output that is the image's horizontal field of view in degrees, (N,)
    hfov_output: Text | None = None

    def focal_px_at(self, width: int) -> float:
        """Focal length in pixels of an input of this nominal width."""
        if self.hfov_deg is None:
            return self.focal_px or 1.0
        return focal_px_of_hfov(self.hfov_deg, width)


@dataclass(frozen=True, slots=True)
class OnnxSpec:
    """Versions that decide which onnxruntime can load the file, and which output is the map."""

    opset: Count | None = None
    ir: Count | None = None
    output: Text | None = None  #: name of the output that is the depth map; None for the only one


_Address: TypeAlias = Annotated[
    str, Rule("an address: https://host/name", re.compile(r"https?://[!-~]+").fullmatch)
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


@dataclass(frozen=True, slots=True)
class Verification:
    """Comparison of the card with the authors' code, on a network of random weights.

    Differences are the largest of several images: mean absolute difference by standard deviation
    of the authors' values.
    """

    package: Text | None = None  #: their code, with its version; None if it was not compared
    why_none: Text | None = None  #: why it was not compared
    date: Text | None = None  #: day of the comparison
    pictures: Count | None = None  #: number of images
    difference: float | None = None  #: at the network's size
    full_size: float | None = None  #: at the image's size, with ``--upsampling model``
    note: Text | None = None  #: what of their code was compared, if not all


SCHEMA = 1
METADATA_KEY = "depthcli.card"
"""Key of the ONNX metadata under which a model carries its own card."""
_UNPRINTABLE = "[\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
_DYNAMIC_ONLY = frozenset(Fit) - {Fit.STRETCH, Fit.KEEP_ASPECT}
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
class DataFile:
    """A file beside an ONNX file, with weights that are not inside it."""

    file: _FileName  #: its name, as the ONNX file states it
    sha256: _Sha256  #: its checksum, 64 hex digits
    size_bytes: Count  #: its size (``bytes`` in JSON)


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
        data: the files with weights that are not inside that file.
        float_model: the same network in floats, which replaces this one on other providers than
            the CPU; None if there is none.
        error_model: the model whose output is the relative error that the depth of this one is
            expected to have; None if there is none.
        weights: where the weights are published; None if the card does not say.
        verification: how the card was compared with the authors' code; None if the card does not
            say.
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
    onnx: OnnxSpec = OnnxSpec()
    file: _FileName | None = None
    sha256: _Sha256 | None = None
    size_bytes: Count | None = None
    data: tuple[DataFile, ...] = ()
    float_model: _ModelName | None = None
    error_model: _ModelName | None = None
    weights: WeightsSpec | None = None
    verification: Verification | None = None
    training: Mapping[str, Any] = field(default_factory=dict)
    scores: Mapping[str, Any] = field(default_factory=dict)
    latency: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def from_json(cls, text: str | bytes, *, where: str = "card") -> "ModelCard":
        """Read a card's JSON, which messages call ``where``."""
        try:
            parsed = parsed_json(text)
            if not isinstance(parsed, dict):
                raise FieldError.expected("a JSON object", parsed)
            schema = parsed.pop("schema", None)
            if schema != SCHEMA or schema is True:
                problem = (
                    f"has schema {short_repr(schema)}, this depthcli reads {SCHEMA}: upgrade it"
                )
                raise FieldError(problem)  # noqa: TRY301 - as those of its fields
            others = parsed.get("data")
            others = others if isinstance(others, list) else []
            for file in (parsed, parsed.get("weights"), *others):
                _read_file_facts(file)
            card = validated(cls, parsed)
            _check(card)
        except FieldError as refused:
            raise ModelError(f"{where}: {refused}; correct the card or restore the model") from None
        return card

    def to_json(self) -> str:
        """The card as JSON text, readable by :meth:`from_json`."""
        text = json.dumps({"schema": SCHEMA, **_stated(self)}, indent=2, ensure_ascii=False)
        # JSON escapes only the first 32 control characters; terminals interpret others, too.
        return re.sub(_UNPRINTABLE, lambda match: f"\\u{ord(match[0]):04x}", text) + "\n"


_ALWAYS_STATED = frozenset({"min_m", "max_m", "training", "scores", "latency"})


def _stated(record: Any) -> dict[str, Any]:  # noqa: ANN401 - any of the dataclasses above
    """The fields of a record as JSON values, without optional ones that have their default.

    So cards without newer fields stay readable everywhere.
    """
    values = {
        attribute.name: getattr(record, attribute.name)
        for attribute in fields(record)
        if attribute.name in _ALWAYS_STATED or getattr(record, attribute.name) != attribute.default
    }
    return {
        "bytes" if name == "size_bytes" else name: _stated(value)
        if is_dataclass(value)
        else [_stated(item) if is_dataclass(item) else item for item in value]
        if isinstance(value, tuple)
        else value
        for name, value in values.items()
    }


def _read_file_facts(values: object) -> None:
    """Bring size and checksum of a JSON object about a file into the form of the fields."""
    if not isinstance(values, dict):
        return
    if "bytes" in values:
        values["size_bytes"] = values.pop("bytes")
    if isinstance(values.get("sha256"), str):
        values["sha256"] = values["sha256"].lower()


def _check(card: ModelCard) -> None:
    """Check what fields state together."""
    spec, output, camera = card.input, card.output, card.camera
    least_m, most_m = output.min_m, output.max_m
    for name, numbers in (("mean", spec.mean), ("std", spec.std)):
        if len(numbers) not in {1, spec.colour.channels}:
            raise FieldError("has to be one number, or one a channel", f"input.{name}")
    if spec.fit in _DYNAMIC_ONLY and not spec.dynamic:
        raise FieldError(f"is {spec.fit}, which needs a dynamic size", "input.fit")
    if spec.fit in _DYNAMIC_ONLY and spec.pixel_aspect != 1:
        raise FieldError(f"has to be 1 with a fit of {spec.fit}", "input.pixel_aspect")
    if spec.prompt and output.transform is not Transform.EXP:
        raise FieldError(f"has to be {Transform.EXP} with a prompt", "output.transform")
    if output.kind is DepthKind.METRIC and (least_m is None or most_m is None):
        raise FieldError("and max_m have to be numbers, as the kind is metric", "output.min_m")
    if least_m is not None and most_m is not None and not 0 <= least_m < most_m:
        raise FieldError("has to be at least 0 and below max_m", "output.min_m")
    if camera is not None and (camera.hfov_deg is None) == (camera.focal_px is None):
        raise FieldError("or focal_px has to be stated, and one alone", "camera.hfov_deg")


_ALIGN = {
    DepthKind.METRIC: "",
    DepthKind.RELATIVE: " --align depth",
    DepthKind.INVERSE: " --align disparity",
}


@dataclass(frozen=True, slots=True)
class PreprocessingCheck:
    """Verification of a card's size, colours, mean and deviation."""

    #: whether the real weights were run with them on images of known depth
    run_with_weights: bool
    verified: str  #: how, one sentence


def preprocessing_check(card: ModelCard) -> PreprocessingCheck | None:
    """The check that a card states under ``training``; None if it states none."""
    try:
        return validated(PreprocessingCheck, card.training.get("preprocessing"))
    except FieldError:
        return None


def verification_text(card: ModelCard) -> str:
    """How a card was compared with its authors' code, for people."""
    verification = card.verification
    if verification is None or verification.difference is None:
        return f"no: {verification.why_none}" if verification and verification.why_none else "no"
    sizes = f"{verification.difference:.0e}"
    if verification.full_size is not None:
        sizes += f", full size {verification.full_size:.0e}"
    return f"{verification.package}, {verification.date}: {sizes}"


def check_command(card: ModelCard) -> str:
    """The command that compares a model with known depth on a few images."""
    return (
        f"depthcli eval nyu --data NYU --split val --limit 20 --model {card.name}"
        + (_ALIGN[card.output.kind])
    )


def fit_to_graph(
    card: ModelCard, fixed_size: tuple[int | None, int | None], path: Path, *, adapt: bool
) -> ModelCard:
    """Compare a card with the input's (height, width) in the graph; None where that is dynamic.

    With ``adapt`` the graph's size replaces the card's, for networks that are exported at several
    sizes. Images are then stretched to it if the card has a dynamic size.
    """
    spec = card.input
    height, width = fixed_size[0] or spec.height, fixed_size[1] or spec.width
    same = (height, width) == (spec.height, spec.width)
    if fixed_size == (None, None) or (same and (not spec.dynamic or spec.fit is Fit.STRETCH)):
        return card
    if not adapt:
        raise ModelError(
            f"{path} takes images of {width} x {height} pixels only; set input.width to {width}, "
            f"input.height to {height} and input.dynamic to false in the card"
        )
    pixel_aspect = spec.pixel_aspect
    if spec.fit is Fit.STRETCH:  # the aspect of the training images is the same
        pixel_aspect *= (spec.width * height) / (spec.height * width)
    return replace(
        card,
        input=replace(
            spec,
            width=width,
            height=height,
            dynamic=False,
            fit=Fit.STRETCH if spec.fit in _DYNAMIC_ONLY else spec.fit,
            pixel_aspect=pixel_aspect,
        ),
    )
