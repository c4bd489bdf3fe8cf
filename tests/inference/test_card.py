"""Cards are read strictly: what is wrong is named."""

import json
import math
from typing import Any

import pytest
from helpers.tiny import CARD, card_with

from depthcli.core.types import DepthKind
from depthcli.errors import ModelError
from depthcli.models.card import Colour, Fit, ModelCard


def read(changes: dict[str, Any]) -> ModelCard:
    return ModelCard.from_json(json.dumps(card_with(changes)), where="a.json")


def test_every_field_arrives() -> None:
    card = read(
        {
            "file": "model.onnx",
            "sha256": "A" * 64,
            "bytes": 7,
            "camera": {"hfov_deg": 63.3},
            "training": {"pairs": 1000},
            "scores": {"abs_rel": 0.2},
            "latency": {"cpu_ms": 20},
        }
    )
    assert (card.name, card.version, card.license) == ("tiny", "1.0.0", "MIT")
    assert (card.input.colour, card.input.fit) == (Colour.VALUE, Fit.STRETCH)
    assert (card.input.width, card.input.height, card.input.mean) == (16, 12, (0.5,))
    assert (card.output.kind, card.output.min_m, card.output.max_m) == (DepthKind.METRIC, 0.5, 10)
    assert math.isclose(card.camera.hfov_deg, 63.3)
    assert (card.onnx.opset, card.onnx.ir) == (17, 8)
    assert (card.file, card.sha256, card.size_bytes) == ("model.onnx", "a" * 64, 7)
    assert card.training == {"pairs": 1000}
    assert card.scores == {"abs_rel": 0.2}
    assert card.latency == {"cpu_ms": 20}


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"schema": 2}, "schema 2"),
        ({"name": ""}, "name"),
        ({"surprise": 1}, "surprise"),
        ({"camera": {"hfov_deg": 60, "surprise": 1}}, "camera.surprise"),
        ({"input.colour": "hsv"}, "input.colour"),
        ({"output.enlarging": "area"}, "enlarging has to be linear, linear-corners or cubic"),
        ({"input.layout": "chw"}, "input.layout has to be one of nchw, nhwc"),
        ({"input.width": 0}, "input.width"),
        ({"input.height": 0}, "input.height"),
        ({"input.multiple_of": 0}, "input.multiple_of"),
        ({"input.width": 16.0}, "input.width"),
        ({"input.width": True}, "input.width"),
        ({"input.mean": [0.1, 0.2, 0.3]}, "input.mean"),
        ({"input.mean": 0.5}, "input.mean"),
        ({"input.std": [0]}, "input.std"),
        ({"input.pixel_aspect": 0}, "input.pixel_aspect"),
        ({"input.pixel_aspect": 2, "input.fit": "lower-bound"}, "input.pixel_aspect"),
        ({"output.kind": "metres"}, "output.kind"),
        ({"output.scale": None}, "output.scale"),
        ({"output.min_m": None}, "output.min_m"),
        ({"output.min_m": 11}, "output.min_m"),
        ({"output": []}, "output"),
        ({"camera": {"hfov_deg": 180}}, "camera.hfov_deg"),
        ({"camera": {"hfov_deg": 179.99}}, "camera.hfov_deg"),
        ({"camera": {}}, "camera.hfov_deg"),
        ({"onnx.opset": 0}, "onnx.opset"),
        ({"sha256": "abc"}, "sha256"),
        ({"file": "../model.onnx"}, "file"),
        ({"file": ".."}, "file"),
        ({"float_model": "https://example.org/a"}, "float_model"),
        ({"float_model": "a.onnx"}, "float_model"),
        ({"bytes": 0}, "bytes"),
        ({"scores": [1]}, "scores"),
        ({"output.scale": 0}, "output.scale"),
        ({"summary": "\x1b]0;title\x07 depth"}, "summary"),
        ({"name": "a\x9b31m"}, "name"),
    ],
)
def test_error_names_the_wrong_value(changes: dict[str, Any], named: str) -> None:
    with pytest.raises(ModelError) as caught:
        read(changes)
    assert str(caught.value).startswith("a.json")
    assert named in str(caught.value)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("name", sorted(CARD.keys() - {"schema", "onnx"}))
def test_error_names_the_missing_field(name: str) -> None:
    card = {key: value for key, value in CARD.items() if key != name}
    with pytest.raises(ModelError, match=f"{name} is missing"):
        ModelCard.from_json(json.dumps(card))


def test_no_character_of_a_card_moves_a_terminal() -> None:
    card = read({"training": {"by": "\x1b[2J \x9b2J \x7f \u202e \ud800 é 深"}})
    text = card.to_json()
    assert text.replace("\n", "").isprintable()
    assert "é 深" in text
    assert ModelCard.from_json(text) == card


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "null", "[" * 200_000, "9" * 5000, '{"schema": NaN}', b"\xff\xfe\xfa"]
)
def test_file_that_is_not_a_card_is_refused(text: str | bytes) -> None:
    with pytest.raises(ModelError):
        ModelCard.from_json(text)
