"""A checkpoint to a model on disk that the rest of depthcli takes as it is."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import onnx
import pytest
import torch
from helpers.small import EFFICIENT, RESNET, small_network, write_checkpoint

from depthcli.errors import CheckpointError, DepthcliError, OutputError, ParityError, UsageError
from depthcli.export.onnx import ExportOptions, card_path, export_checkpoint
from depthcli.inference.session import Session
from depthcli.models.catalog import find_model

if TYPE_CHECKING:
    from depthcli.training.config import GeneratorConfig


@pytest.mark.parametrize("config", [EFFICIENT, RESNET], ids=["efficient", "resnet"])
def test_round_trip(config: GeneratorConfig, tmp_path: Path) -> None:
    network = small_network(config)
    checkpoint = write_checkpoint(tmp_path / "last.ckpt", network, config)
    done = export_checkpoint(checkpoint, tmp_path / "room" / "model.onnx", ExportOptions())
    model = find_model(tmp_path / "room")
    assert (model.card, model.path) == (done.card, done.path)
    image = np.random.default_rng(0).uniform(-1, 1, (2, 1, 32, 48)).astype(np.float32)
    with torch.no_grad():
        wanted = network(torch.from_numpy(image))[:, 0].numpy()
    np.testing.assert_allclose(Session(model, provider="cpu").run(image), wanted, atol=1e-3)


@pytest.mark.parametrize(("half", "allowed"), [(False, 1e-3), (True, 2e-2)])
def test_the_gate_is_as_narrow_as_the_weights_allow(
    half: bool, allowed: float, tmp_path: Path
) -> None:
    checkpoint = write_checkpoint(tmp_path / "last.ckpt")
    parity = export_checkpoint(checkpoint, tmp_path / "a.onnx", ExportOptions(half=half)).parity
    assert parity.tolerance == allowed
    own = ExportOptions(half=half, tolerance=parity.max_abs / 2)
    with pytest.raises(ParityError):
        export_checkpoint(checkpoint, tmp_path / "b.onnx", own)
    assert not (tmp_path / "b.onnx").exists()


def test_onnx_file_alone_is_enough(tmp_path: Path) -> None:
    checkpoint = write_checkpoint(tmp_path / "last.ckpt")
    done = export_checkpoint(checkpoint, tmp_path / "room.onnx", ExportOptions())
    (tmp_path / "room.card.json").unlink()
    alone = find_model(tmp_path / "room.onnx").card
    assert alone == dataclasses.replace(done.card, file=None, sha256=None, size_bytes=None)


def test_one_file_and_its_card_are_all_that_is_written(tmp_path: Path) -> None:
    checkpoint = write_checkpoint(tmp_path / "last.ckpt")
    export_checkpoint(checkpoint, tmp_path / "out" / "room.onnx", ExportOptions())
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["room.card.json", "room.onnx"]


def test_models_in_one_folder_keep_their_own_cards(tmp_path: Path) -> None:
    checkpoint = write_checkpoint(tmp_path / "last.ckpt")
    for name in ("one", "two"):
        half = name == "two"
        export_checkpoint(checkpoint, tmp_path / f"{name}.onnx", ExportOptions(name, half=half))
    assert [find_model(tmp_path / f"{n}.onnx").card.name for n in ("one", "two")] == ["one", "two"]
    assert card_path(Path("a/model.onnx")) == Path("a/card.json")


@pytest.mark.parametrize("card", ['{"file": "net.onnx"}', '{"name": "a draft"}', "[]", ""])
def test_the_card_of_another_model_is_not_replaced(tmp_path: Path, card: str) -> None:
    checkpoint = write_checkpoint(tmp_path / "last.ckpt")
    (tmp_path / "card.json").write_text(card)
    with pytest.raises(UsageError):
        export_checkpoint(checkpoint, tmp_path / "model.onnx", ExportOptions())
    assert (tmp_path / "card.json").read_text() == card
    assert not (tmp_path / "model.onnx").exists()


def test_same_checkpoint_gives_the_same_bytes(tmp_path: Path) -> None:
    checkpoint = write_checkpoint(tmp_path / "last.ckpt")
    first, second = (
        export_checkpoint(checkpoint, tmp_path / folder / "m.onnx", ExportOptions()).card.sha256
        for folder in "ab"
    )
    assert first == second


def test_averaged_weights_are_the_ones_exported(tmp_path: Path) -> None:
    average = small_network(seed=5)
    checkpoint = write_checkpoint(tmp_path / "last.ckpt", small_network(seed=1), average=average)
    done = export_checkpoint(checkpoint, tmp_path / "room.onnx", ExportOptions())
    image = np.full((1, 1, 32, 48), 0.25, np.float32)
    with torch.no_grad():
        wanted = average(torch.from_numpy(image))[:, 0].numpy()
    found = Session(find_model(done.path), provider="cpu").run(image)
    np.testing.assert_allclose(found, wanted, atol=1e-3)


def test_half_weights_halve_the_file(tmp_path: Path) -> None:
    config = dataclasses.replace(EFFICIENT, encoder=(8, 16, 32, 32, 64))
    checkpoint = write_checkpoint(tmp_path / "last.ckpt", generator=config)
    sizes = [
        export_checkpoint(checkpoint, tmp_path / f"{half}.onnx", ExportOptions(half=half))
        .path.stat()
        .st_size
        for half in (False, True)
    ]
    assert sizes[1] < 0.6 * sizes[0]
    kinds = {t.data_type for t in onnx.load(tmp_path / "True.onnx").graph.initializer}
    assert onnx.TensorProto.FLOAT16 in kinds


def test_nothing_is_written_when_the_gate_refuses(tmp_path: Path) -> None:
    checkpoint, out = write_checkpoint(tmp_path / "last.ckpt"), tmp_path / "out"
    with pytest.raises(ParityError):
        export_checkpoint(checkpoint, out / "m.onnx", ExportOptions(half=True, tolerance=1e-6))
    assert not out.exists()


def test_gate_leaves_an_older_model_in_place(tmp_path: Path) -> None:
    checkpoint, path = write_checkpoint(tmp_path / "last.ckpt"), tmp_path / "m.onnx"
    export_checkpoint(checkpoint, path, ExportOptions())
    before = path.read_bytes()
    with pytest.raises(ParityError):
        export_checkpoint(checkpoint, path, ExportOptions(half=True, tolerance=1e-6))
    assert path.read_bytes() == before
    assert find_model(path).data == before


@pytest.mark.parametrize("kept", [0, 1, 100, -1])
def test_truncated_checkpoint(kept: int, tmp_path: Path) -> None:
    checkpoint = write_checkpoint(tmp_path / "last.ckpt")
    checkpoint.write_bytes(checkpoint.read_bytes()[:kept])
    with pytest.raises(CheckpointError):
        export_checkpoint(checkpoint, tmp_path / "m.onnx", ExportOptions())
    assert not (tmp_path / "m.onnx").exists()


def test_checkpoint_of_another_network(tmp_path: Path) -> None:
    checkpoint = write_checkpoint(tmp_path / "last.ckpt", small_network(RESNET), EFFICIENT)
    with pytest.raises(CheckpointError):
        export_checkpoint(checkpoint, tmp_path / "m.onnx", ExportOptions())


def test_missing_and_foreign_checkpoints(tmp_path: Path) -> None:
    torch.save({"state_dict": {}}, tmp_path / "foreign.ckpt")
    for name in ("foreign.ckpt", "none.ckpt"):
        with pytest.raises(CheckpointError):
            export_checkpoint(tmp_path / name, tmp_path / "m.onnx", ExportOptions())


@pytest.mark.parametrize("name", ["m.onnx", "m.card.json"])
def test_checkpoint_is_never_its_own_output(tmp_path: Path, name: str) -> None:
    checkpoint = write_checkpoint(tmp_path / name)
    before = checkpoint.read_bytes()
    with pytest.raises(DepthcliError):
        export_checkpoint(checkpoint, tmp_path / "m.onnx", ExportOptions())
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {name: before}


def test_a_card_that_cannot_be_written_leaves_the_old_model(tmp_path: Path) -> None:
    checkpoint, out = write_checkpoint(tmp_path / "last.ckpt"), tmp_path / "room.onnx"
    out.write_bytes(b"the old one")
    card_path(out).mkdir()
    with pytest.raises(OutputError):
        export_checkpoint(checkpoint, out, ExportOptions())
    assert out.read_bytes() == b"the old one"
    assert {path.name for path in tmp_path.iterdir()} == {
        *("last.ckpt", "room.onnx", "room.card.json")
    }


def test_card_is_json(tmp_path: Path) -> None:
    checkpoint = write_checkpoint(tmp_path / "last.ckpt")
    done = export_checkpoint(checkpoint, tmp_path / "m.onnx", ExportOptions())
    card = json.loads((tmp_path / "m.card.json").read_text("utf-8"))
    assert card["file"] == "m.onnx"
    assert card["bytes"] == done.path.stat().st_size
    assert card["sha256"] == hashlib.sha256(done.path.read_bytes()).hexdigest()
    sizes = ((1, 32, 48), (3, 32, 48), (1, 48, 32), (2, 16, 48), (1, 64, 96))
    assert done.parity.cases == sizes  # a batch, on its side, half as high, twice as large
    assert card["onnx"] == {"opset": 17, "ir": 8}
