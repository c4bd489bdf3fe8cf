"""Exporting checkpoints and trained runs."""

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import pytest
from helpers.small import small_network, write_checkpoint

from depthcli.errors import DepthcliError, OutputError, ParityError, UsageError
from depthcli.inference.transforms import input_layout
from depthcli.lab.datasets.base import NYU
from depthcli.lab.datasets.training_data import NYU_PAPER
from depthcli.lab.export.onnx import (
    ExportOptions,
    card_of,
    card_path,
    export_checkpoint,
    export_run,
    find_runs,
    open_run,
)
from depthcli.lab.options import Weights
from depthcli.lab.training.checkpoint import Checkpoint
from depthcli.models.card import ModelCard
from depthcli.models.catalog import find_model


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    return write_checkpoint(tmp_path / "last.ckpt")


def test_onnx_file_alone_is_enough(tmp_path: Path, checkpoint: Path) -> None:
    done = export_checkpoint(checkpoint, tmp_path / "room.onnx", ExportOptions())
    (tmp_path / "room.card.json").unlink()
    alone = find_model(tmp_path / "room.onnx").card
    assert alone == dataclasses.replace(done.card, file=None, sha256=None, size_bytes=None)


def test_models_in_one_folder_keep_their_own_cards(tmp_path: Path, checkpoint: Path) -> None:
    for name in ("one", "two"):
        half = name == "two"
        export_checkpoint(checkpoint, tmp_path / f"{name}.onnx", ExportOptions(name, fp16=half))
    assert [find_model(tmp_path / f"{n}.onnx").card.name for n in ("one", "two")] == ["one", "two"]
    assert card_path(Path("a/model.onnx")) == Path("a/card.json")


@pytest.mark.parametrize("card", ['{"file": "net.onnx"}', '{"name": "a draft"}', "[]", ""])
def test_the_card_of_another_model_is_not_replaced(
    tmp_path: Path, checkpoint: Path, card: str
) -> None:
    (tmp_path / "card.json").write_text(card)
    with pytest.raises(UsageError):
        export_checkpoint(checkpoint, tmp_path / "model.onnx", ExportOptions())
    assert (tmp_path / "card.json").read_text() == card
    assert not (tmp_path / "model.onnx").exists()


def test_same_checkpoint_gives_the_same_bytes(tmp_path: Path, checkpoint: Path) -> None:
    first, second = (
        export_checkpoint(checkpoint, tmp_path / folder / "m.onnx", ExportOptions()).card.sha256
        for folder in "ab"
    )
    assert first == second


def test_gate_leaves_an_older_model_in_place(tmp_path: Path, checkpoint: Path) -> None:
    path = tmp_path / "m.onnx"
    export_checkpoint(checkpoint, path, ExportOptions())
    before = path.read_bytes()
    with pytest.raises(ParityError):
        export_checkpoint(checkpoint, path, ExportOptions(fp16=True, tolerance=1e-6))
    assert path.read_bytes() == before
    assert find_model(path).sha256 == hashlib.sha256(before).hexdigest()


@pytest.mark.parametrize("name", ["m.onnx", "m.card.json"])
def test_checkpoint_is_never_its_own_output(tmp_path: Path, name: str) -> None:
    checkpoint = write_checkpoint(tmp_path / name)
    before = checkpoint.read_bytes()
    with pytest.raises(DepthcliError):
        export_checkpoint(checkpoint, tmp_path / "m.onnx", ExportOptions())
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {name: before}


def test_a_card_that_cannot_be_written_leaves_the_old_model(
    tmp_path: Path, checkpoint: Path
) -> None:
    out = tmp_path / "room.onnx"
    out.write_bytes(b"the old one")
    card_path(out).mkdir()
    with pytest.raises(OutputError):
        export_checkpoint(checkpoint, out, ExportOptions())
    assert out.read_bytes() == b"the old one"
    assert {path.name for path in tmp_path.iterdir()} == {
        *("last.ckpt", "room.onnx", "room.card.json")
    }


def _card(path: Path, options: ExportOptions | None = None, **facts: Any) -> ModelCard:
    saved = Checkpoint.load(write_checkpoint(path / "last.ckpt", **facts))
    return card_of(saved, options or ExportOptions())


def test_a_card_is_what_the_run_was(tmp_path: Path) -> None:
    ids = ("0003", "0000", "0001", "0012")
    facts = {"pseudo_labels": "rooms", "init_weights": "fast 1.0.0", "train_ids": ids}
    facts |= {"held_out_ids": ("0005",)}
    scores = {"abs_rel": 0.123456, "rmse": float("nan")}
    options = ExportOptions("room", "2.1.0", opset=18, license_name="CC0-1.0")
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
    facts = {"data": "own pairs (yard)", "hfov_deg": None, "train_ids": ("a0001",), "scores": {}}
    card = _card(tmp_path, **facts)
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
    facts = _card(tmp_path, data="own pairs (yard)", **ids | {"train_ids": ("a3", "a0")}).training
    assert (facts["pairs"], facts["nyu_train_ids"]) == (2, "0000-0001")
    copy = _card(tmp_path, data="own pairs (copy)", train_ids=("1400", "0003")).training
    assert copy["nyu_train_ids"] == "0003,1400"


def test_scores_of_averaged_weights_are_not_those_of_the_raw_ones(tmp_path: Path) -> None:
    raw = ExportOptions(weights=Weights.RAW)
    assert _card(tmp_path, raw).training["validation"] == {"abs_rel": 0.25}  # there is no average
    path = write_checkpoint(tmp_path / "both.ckpt", average=small_network())
    assert card_of(Checkpoint.load(path), raw).training["validation"] == {}
    assert card_of(Checkpoint.load(path), ExportOptions()).training["validation"] != {}


def test_scores_are_of_the_network_that_was_validated(tmp_path: Path) -> None:
    """On pairs that its initial weights did not know."""
    scores = {"abs_rel": 0.25}
    for options, init_id, facts in (
        (ExportOptions(), "0002", {"validation": scores}),
        (ExportOptions(), "0001", {"validation": {}}),
        (ExportOptions(fp16=True), "0002", {"validation": scores, "precision": "float16"}),
        (ExportOptions(int8=tmp_path), "0002", {"validation": {}, "precision": "int8"}),
        (ExportOptions(depth_factor=1.03), "0002", {"validation": {}, "depth_factor": 1.03}),
    ):
        ids = {"train_ids": ("0000",), "held_out_ids": ("0001",), "init_ids": {NYU: (init_id,)}}
        card = _card(tmp_path, options, **ids)
        names = card.training.keys() & {"validation", "precision", "depth_factor"}
        assert {name: card.training[name] for name in names} == facts
        most_m = 10 * facts.get("depth_factor", 1)
        assert card.output.codec.decode(1.0) == pytest.approx(most_m)


def test_linear_depth_has_no_smallest_value_of_log_depth(tmp_path: Path) -> None:
    saved = Checkpoint.load(write_checkpoint(tmp_path / "last.ckpt"))
    linear = dataclasses.replace(saved.config.output, coding="linear")
    saved = dataclasses.replace(saved, config=dataclasses.replace(saved.config, output=linear))
    output = card_of(saved, ExportOptions()).output
    assert (output.min_m, output.codec.decode(-1.0)) == (0.001, 0)


@pytest.mark.parametrize("hfov_deg", [None, 80.0])
def test_the_camera_is_the_one_that_is_said(tmp_path: Path, hfov_deg: float | None) -> None:
    camera = _card(tmp_path, ExportOptions(hfov=80.0), hfov_deg=hfov_deg).camera
    assert camera.hfov_deg == 80


def test_a_camera_that_is_known_is_not_contradicted(tmp_path: Path) -> None:
    """Depth has been scaled to it; the user's own lens would be applied twice."""
    with pytest.raises(UsageError):
        _card(tmp_path, ExportOptions(hfov=80.0), hfov_deg=63.3)


@pytest.mark.parametrize(
    ("aspect", "pixel_aspect"), [(4 / 3, 8 / 9), (1.5, 1.0), (16 / 9, 32 / 27)]
)
def test_a_card_keeps_the_pixels_that_the_network_learned(
    tmp_path: Path, aspect: float, pixel_aspect: float
) -> None:
    """Images of any aspect were stretched to 48 x 32."""
    spec = _card(tmp_path, aspect=aspect).input
    assert (spec.fit, spec.pixel_aspect) == ("keep-aspect", pytest.approx(pixel_aspect, abs=1e-9))
    place = input_layout(spec, round(480 * aspect), 480)
    assert (place.width, place.height) == (48, 32)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run that keeps an average."""
    folder = tmp_path / "runs" / "proposed-seed7"
    folder.mkdir(parents=True)
    ids = {"train_ids": ("0001", "0003"), "held_out_ids": ("0002",)}
    ids |= {"init_weights": "model.onnx 1234"}
    write_checkpoint(folder / "last.ckpt", average=small_network(seed=5), **ids)
    return folder


def test_a_run_is_what_its_checkpoint_says(folder: Path) -> None:
    run, saved = open_run(folder), Checkpoint.load(folder / "last.ckpt")
    assert (run.config, run.state, run.provenance) == (saved.config, saved.state, saved.provenance)
    assert run.parameters == sum(weights.numel() for weights in small_network().parameters())
    assert (run.name, run.config.seed) == ("proposed-seed7", 7)
    config, sources = json.loads(run.settings)
    assert config["seed"] == 0
    assert sources == [NYU_PAPER, ["0001", "0003"], ["", {}, ""], "model.onnx 1234"]


def test_runs_are_the_folder_itself_or_those_in_it(folder: Path) -> None:
    for name in ("b", "a"):
        (folder.parent / name).mkdir()
        (folder.parent / name / "last.ckpt").touch()
    (folder.parent / "notes").mkdir()
    assert [run.name for run in find_runs(folder.parent)] == ["a", "b", "proposed-seed7"]
    assert find_runs(folder) == (folder,)
    with pytest.raises(UsageError):
        find_runs(folder.parent / "notes")


def test_a_run_is_exported_by_its_name(folder: Path, tmp_path: Path) -> None:
    model = export_run(open_run(folder), tmp_path, Weights.RAW)
    assert find_model(model).card.name == "proposed-seed7"
    assert not list(folder.glob("*.onnx"))
