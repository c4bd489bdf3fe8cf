"""What a checkpoint knows of itself is in the card of its model, and nothing that it does not."""

from __future__ import annotations

import dataclasses
import json
from typing import TYPE_CHECKING, Any

import pytest
from helpers.small import small_network, write_checkpoint

from depthcli.core.options import Weights
from depthcli.datasets.base import NYU
from depthcli.errors import UsageError
from depthcli.export.onnx import ExportOptions, card_of
from depthcli.inference.transforms import input_layout
from depthcli.models.card import ModelCard
from depthcli.training.checkpoint import Checkpoint

if TYPE_CHECKING:
    from pathlib import Path


def _card(path: Path, options: ExportOptions | None = None, **facts: Any) -> ModelCard:
    saved = Checkpoint.load(write_checkpoint(path / "last.ckpt", **facts))
    return card_of(saved, options or ExportOptions())


def test_a_card_is_what_the_run_was(tmp_path: Path) -> None:
    ids = ("0003", "0000", "0001", "0012")
    facts = {"pseudo_labels": "rooms", "init_weights": "fast 1.0.0", "train_ids": ids}
    facts |= {"held_out_ids": ("0005",)}
    scores = {"abs_rel": 0.123456, "rmse": float("nan")}
    options = ExportOptions("room", "2.1.0", opset=18, license="CC0-1.0")
    card = _card(tmp_path, options, **facts, seconds=3599.0, scores=scores)
    config = dataclasses.asdict(Checkpoint.load(tmp_path / "last.ckpt").config)
    codec = card.output.codec
    assert codec.decode(-1.0) == pytest.approx(0.4)
    assert codec.decode(1.0) == pytest.approx(10)
    assert json.loads(card.to_json()) == {
        "schema": 1,
        "name": "room",
        "version": "2.1.0",
        "summary": "proposed, efficient generator, NYU Depth v2, labelled pairs 1-1000",
        "license": "CC0-1.0",
        "input": {
            "colour": "value",
            "width": 48,
            "height": 32,
            "dynamic": True,
            "multiple_of": 4,
            "fit": "keep-aspect",
            "mean": [0.5],
            "std": [0.5],
            "pixel_aspect": 0.888888889,
        },
        "output": {
            "kind": "metric",
            "transform": "exp",
            "scale": codec.scale,
            "shift": codec.shift,
            "min_m": 0.4,
            "max_m": 10.0,
        },
        "camera": {"hfov_deg": 63.3},
        "onnx": {"opset": 18, "ir": 8},
        "training": {
            "data": "NYU Depth v2, labelled pairs 1-1000",
            "pseudo_labels": "rooms",
            "init_weights": "fast 1.0.0",
            "method": "proposed",
            "seed": 7,
            "pairs": 4,
            "held_out_pairs": 1,
            "nyu_train_ids": "0000-0001,0003,0012",
            "steps": 12,
            "minutes": 60.0,
            "validation": {"abs_rel": 0.1235},
            "config": json.loads(json.dumps(config)),
        },
        "scores": {},
        "latency": {},
    }
    assert ModelCard.from_json(card.to_json()) == card


def test_a_card_claims_nothing_that_nobody_said(tmp_path: Path) -> None:
    own = {"data": "own pairs (yard)", "hfov_deg": None, "train_ids": ("a0001",), "scores": {}}
    card = _card(tmp_path, **own)
    assert "NYU" not in card.to_json().upper()
    assert card.training.keys() == {
        *("data", "method", "seed", "pairs", "held_out_pairs", "steps", "minutes"),
        *("validation", "config"),
    }
    assert (card.name, card.version, card.license) == ("custom", "1.0.0", "NOASSERTION")
    assert (card.camera, card.onnx.opset) == (None, 17)


def test_pairs_that_the_initial_weights_knew_are_known_to_the_model(tmp_path: Path) -> None:
    ids = {"train_ids": ("0003", "0000"), "init_ids": {NYU: ("0000", "0001")}}
    assert _card(tmp_path, **ids).training["nyu_train_ids"] == "0000-0001,0003"
    own = _card(tmp_path, data="own pairs (yard)", **ids | {"train_ids": ("a3", "a0")}).training
    assert (own["pairs"], own["nyu_train_ids"]) == (2, "0000-0001")
    copy = _card(tmp_path, data="own pairs (copy)", train_ids=("1400", "0003")).training
    assert copy["nyu_train_ids"] == "0003,1400"


def test_scores_of_averaged_weights_are_not_those_of_the_raw_ones(tmp_path: Path) -> None:
    raw = ExportOptions(weights=Weights.RAW)
    assert _card(tmp_path, raw).training["validation"] == {"abs_rel": 0.25}  # there is no average
    path = write_checkpoint(tmp_path / "both.ckpt", average=small_network())
    assert card_of(Checkpoint.load(path), raw).training["validation"] == {}
    assert card_of(Checkpoint.load(path), ExportOptions()).training["validation"] != {}


def test_scores_of_pairs_that_the_initial_weights_knew_are_not_stated(tmp_path: Path) -> None:
    ids = {"train_ids": ("0000",), "held_out_ids": ("0001",)}
    for known, scores in (("0002", {"abs_rel": 0.25}), ("0001", {})):
        card = _card(tmp_path, **ids, init_ids={NYU: (known,)})
        assert card.training["validation"] == scores


def test_scores_are_of_the_network_that_was_validated(tmp_path: Path) -> None:
    scores = {"abs_rel": 0.25}
    for options, facts in (
        (ExportOptions(), {"validation": scores}),
        (ExportOptions(half=True), {"validation": scores, "precision": "float16"}),
        (ExportOptions(mirror=True), {"validation": {}, "mirror": True}),
        (ExportOptions(int8_pictures=tmp_path), {"validation": {}, "precision": "int8"}),
    ):
        training = _card(tmp_path, options).training
        names = training.keys() & {"validation", "precision", "mirror"}
        assert {name: training[name] for name in names} == facts


def test_linear_depth_has_no_smallest_value_of_log_depth(tmp_path: Path) -> None:
    saved = Checkpoint.load(write_checkpoint(tmp_path / "last.ckpt"))
    linear = dataclasses.replace(saved.config.output, coding="linear")
    saved = dataclasses.replace(saved, config=dataclasses.replace(saved.config, output=linear))
    output = card_of(saved, ExportOptions()).output
    assert (output.min_m, output.codec.decode(-1.0)) == (0.001, 0)


@pytest.mark.parametrize("known", [None, 80.0])
def test_the_camera_is_the_one_that_is_said(tmp_path: Path, known: float | None) -> None:
    camera = _card(tmp_path, ExportOptions(hfov_deg=80.0), hfov_deg=known).camera
    assert camera is not None
    assert camera.hfov_deg == 80


def test_a_camera_that_is_known_is_not_contradicted(tmp_path: Path) -> None:
    """Depth has been scaled to it; the user's own lens would be applied twice."""
    with pytest.raises(UsageError):
        _card(tmp_path, ExportOptions(hfov_deg=80.0), hfov_deg=63.3)


@pytest.mark.parametrize(
    ("aspect", "pixel_aspect"), [(4 / 3, 8 / 9), (1.5, 1.0), (16 / 9, 32 / 27)]
)
def test_a_card_keeps_the_pixels_that_the_network_learned(
    tmp_path: Path, aspect: float, pixel_aspect: float
) -> None:
    """Pictures of any aspect were stretched to 48 x 32."""
    spec = _card(tmp_path, aspect=aspect).input
    assert (spec.fit, spec.pixel_aspect) == ("keep-aspect", pytest.approx(pixel_aspect, abs=1e-9))
    place = input_layout(spec, round(480 * aspect), 480)
    assert (place.width, place.height) == (48, 32)


@pytest.mark.parametrize("tolerance", [None, 0.0, 0.5])
@pytest.mark.parametrize(
    ("half", "has_pictures", "usual"),
    [(False, False, 1e-3), (True, False, 2e-2), (True, True, 0.2)],
)
def test_tolerance_of_parity_depends_on_precision(
    tmp_path: Path, tolerance: float | None, *, half: bool, has_pictures: bool, usual: float
) -> None:
    pictures = tmp_path if has_pictures else None
    options = ExportOptions(half=half, tolerance=tolerance, int8_pictures=pictures)
    assert options.max_difference == (usual if tolerance is None else tolerance)
