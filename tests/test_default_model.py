"""The model that ships: its card is true, and it says what it said when it was released."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import onnx
import pytest

import depthcli
from depthcli.inference.card import ModelCard

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "models" / "default"
REFERENCES = {
    "bilinear": Path(__file__).parent / "reference" / "default-room.npy",
    "guided": Path(__file__).parent / "reference" / "default-room-guided.npy",
}
ROOM_TRUE_MEDIAN_M = 3.692  # printed by docs/render_room.py


@pytest.fixture(scope="module")
def depth() -> depthcli.DepthMap:
    pipeline = depthcli.load(FOLDER, provider="cpu")
    return pipeline.predict(depthcli.read_image(ROOT / "docs" / "room.jpg"))


@pytest.mark.parametrize("upsampling", sorted(REFERENCES))
def test_reproduces_its_stored_output(upsampling: str) -> None:
    detail = depthcli.Detail(depthcli.Upsampling(upsampling))
    pipeline = depthcli.load(FOLDER, provider="cpu", detail=detail)
    depth = pipeline.predict(depthcli.read_image(ROOT / "docs" / "room.jpg"))
    assert np.abs(depth.values[::8, ::8] - np.load(REFERENCES[upsampling])).max() < 0.02


def test_the_picture_guides_unless_told_otherwise(depth: depthcli.DepthMap) -> None:
    assert np.abs(depth.values[::8, ::8] - np.load(REFERENCES["guided"])).max() < 0.02
    assert np.abs(depth.values[::8, ::8] - np.load(REFERENCES["bilinear"])).max() > 0.1


def test_sees_the_rendered_room(depth: depthcli.DepthMap) -> None:
    assert depth.values.shape == (480, 640)
    assert np.median(depth.values) == pytest.approx(ROOM_TRUE_MEDIAN_M, rel=0.35)
    floor, far_wall = depth.values[440:, 250:400].mean(), depth.values[230:300, 330:430].mean()
    assert floor < 0.8 * far_wall


def test_card_is_true() -> None:
    card = ModelCard.from_json((FOLDER / "card.json").read_bytes())
    data = (FOLDER / "model.onnx").read_bytes()
    assert card.sha256 == hashlib.sha256(data).hexdigest()
    assert card.size_bytes == len(data) <= 25_000_000
    assert {"data", "method", "steps", "seed"} <= card.training.keys()
    assert {"protocol", "split", "abs_rel", "rmse", "d1"} <= card.scores.keys()


def test_graph_is_folded_and_loads_in_old_runtimes() -> None:
    model = onnx.load(FOLDER / "model.onnx")
    assert "BatchNormalization" not in {node.op_type for node in model.graph.node}
    assert model.ir_version <= 8
    assert all(entry.version <= 17 for entry in model.opset_import if not entry.domain)


def test_takes_any_size_and_batch() -> None:
    session = depthcli.load(FOLDER, provider="cpu").session
    for shape in ((3, 1, 144, 192), (1, 1, 192, 144), (1, 1, 288, 384)):
        assert session.run(np.zeros(shape, np.float32)).shape[0] == shape[0]
