"""A model's card: everything that is needed to run the model, so that a new model needs no code."""

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from depthcli.core.codec import Transform
from depthcli.core.types import DepthKind
from depthcli.errors import ModelError
from depthcli.models.card_fields import Fields
from depthcli.models.card_specs import (
    CameraSpec,
    Colour,
    Fit,
    InputSpec,
    OnnxSpec,
    OutputSpec,
    Resize,
    TensorLayout,
)

SCHEMA = 1
METADATA_KEY = "depthcli.card"
"""Key of the ONNX metadata under which a model carries its own card."""
_MAX_HFOV_DEG = 180.0
_MAX_SIDE = 2**15
_MAX_INPUT_PIXELS = 2**24
"""Beyond, the first layers of a network take more memory than machines have."""
_OPTIONAL_INPUT = {"resize": Resize.AREA, "layout": TensorLayout.NCHW, "pixel_aspect": 1.0}
_UNPRINTABLE = re.compile("[\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
_BOUNDS = frozenset({Fit.LOWER_BOUND, Fit.UPPER_BOUND})


@dataclass(frozen=True, slots=True)
class ModelCard:
    """One model, as written in its ``card.json`` or inside its ONNX file.

    Attributes:
        name: what ``--model`` calls it.
        version: of the weights.
        summary: one line for people.
        license: SPDX name.
        input: the network's input.
        output: the meaning of its output.
        camera: the camera it learned; None leaves metres as they come.
        onnx: opset and IR version.
        file: name of the ONNX file beside the card; None in an embedded card.
        sha256: checksum of that file, 64 hex digits; None in an embedded card.
        size_bytes: size of that file (``bytes`` in JSON); None in an embedded card.
        training: how it came to be; free.
        scores: what it reaches on which protocol; free.
        latency: how fast it is on which machine; free.
    """

    name: str
    version: str
    summary: str
    license: str
    input: InputSpec
    output: OutputSpec
    camera: CameraSpec | None
    onnx: OnnxSpec
    file: str | None = None
    sha256: str | None = None
    size_bytes: int | None = None
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
            parsed = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise ModelError(f"{where} is not valid JSON ({error}); restore the model") from error
        fields = Fields(parsed, where)
        schema = fields.integer("schema", minimum=1)
        if schema != SCHEMA:
            raise ModelError(
                f"{where} has schema {schema}, this depthcli reads {SCHEMA}; upgrade depthcli"
            )
        return _card(fields)

    def to_json(self) -> str:
        """The card as JSON text, readable by :meth:`from_json`."""
        values = asdict(self)
        values["bytes"] = values.pop("size_bytes")
        for name in ("file", "sha256", "bytes"):
            if values[name] is None:
                del values[name]
        for name in ("mean", "std"):
            values["input"][name] = list(values["input"][name])
        for name, default in _OPTIONAL_INPUT.items():
            if values["input"][name] == default:  # cards without it stay readable everywhere
                del values["input"][name]
        text = json.dumps(
            {"schema": SCHEMA, **values}, indent=2, ensure_ascii=False, allow_nan=False
        )
        # JSON itself escapes only the first 32; a terminal obeys others, too.
        return _UNPRINTABLE.sub(lambda found: f"\\u{ord(found[0]):04x}", text) + "\n"


def _card(fields: Fields) -> ModelCard:
    card = ModelCard(
        name=fields.text("name"),
        version=fields.text("version"),
        summary=fields.text("summary"),
        license=fields.text("license"),
        input=_input(fields.section("input")),
        output=_output(fields.section("output")),
        camera=_camera(fields.optional_section("camera")),
        onnx=_onnx(fields.section("onnx")),
        file=fields.file_name("file") if fields.has("file") else None,
        sha256=fields.sha256("sha256") if fields.has("sha256") else None,
        size_bytes=fields.integer("bytes", minimum=1) if fields.has("bytes") else None,
        training=fields.free("training"),
        scores=fields.free("scores"),
        latency=fields.free("latency"),
    )
    fields.close()
    return card


def _input(fields: Fields) -> InputSpec:
    colour = fields.choice("colour", Colour)
    lengths = {1, colour.channels}
    spec = InputSpec(
        colour=colour,
        width=fields.integer("width", minimum=1, maximum=_MAX_SIDE),
        height=fields.integer("height", minimum=1, maximum=_MAX_SIDE),
        dynamic=fields.flag("dynamic"),
        multiple_of=fields.integer("multiple_of", minimum=1, maximum=_MAX_SIDE),
        fit=fields.choice("fit", Fit),
        mean=fields.numbers("mean", lengths),
        std=fields.numbers("std", lengths),
        resize=fields.optional_choice("resize", Resize.AREA),
        layout=fields.optional_choice("layout", TensorLayout.NCHW),
        pixel_aspect=fields.number("pixel_aspect") if fields.has("pixel_aspect") else 1.0,
    )
    if spec.width * spec.height > _MAX_INPUT_PIXELS:
        fields.fail("width", f"times height has to be at most {_MAX_INPUT_PIXELS:,} pixels")
    if min(spec.std) <= 0:
        fields.fail("std", "must be greater than 0")
    if spec.fit in _BOUNDS and not spec.dynamic:
        fields.fail("fit", f"is {spec.fit}, which a network of one fixed size cannot have")
    if spec.pixel_aspect <= 0:
        fields.fail("pixel_aspect", "must be greater than 0")
    if spec.fit in _BOUNDS and spec.pixel_aspect != 1:
        fields.fail("pixel_aspect", f"has to be 1, or left out, with a fit of {spec.fit}")
    fields.close()
    return spec


def _output(fields: Fields) -> OutputSpec:
    kind = fields.choice("kind", DepthKind)
    metric = kind is DepthKind.METRIC
    spec = OutputSpec(
        kind=kind,
        transform=fields.choice("transform", Transform),
        scale=fields.number("scale"),
        shift=fields.number("shift"),
        min_m=fields.number("min_m") if metric else fields.optional_number("min_m"),
        max_m=fields.number("max_m") if metric else fields.optional_number("max_m"),
    )
    if spec.min_m is not None and spec.max_m is not None and not 0 <= spec.min_m < spec.max_m:
        fields.fail("min_m", "has to be at least 0 and below max_m")
    fields.close()
    return spec


def _camera(fields: Fields | None) -> CameraSpec | None:
    if fields is None:
        return None
    spec = CameraSpec(hfov_deg=fields.number("hfov_deg"))
    if not 0 < spec.hfov_deg < _MAX_HFOV_DEG:
        fields.fail("hfov_deg", "must be between 0 and 180")
    fields.close()
    return spec


def _onnx(fields: Fields) -> OnnxSpec:
    spec = OnnxSpec(opset=fields.integer("opset", minimum=1), ir=fields.integer("ir", minimum=1))
    fields.close()
    return spec
