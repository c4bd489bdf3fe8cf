"""Every method ends as a model that the command line runs, equal to its network in torch."""

from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from helpers.rooms import room_data, rooms
from helpers.tiny import load
from helpers.tiny_methods import tiny
from lightning_fabric import Fabric

from depthcli.core.options import Detail, Upsampling
from depthcli.core.types import DepthKind, Frame
from depthcli.export.onnx import ExportOptions, export_checkpoint
from depthcli.inference.transforms import prepare
from depthcli.training.callbacks import Callback
from depthcli.training.checkpoint import CHECKPOINT, load_generator
from depthcli.training.methods.table import METHODS
from depthcli.training.run import fit


@pytest.mark.parametrize("name", METHODS)
def test_a_trained_method_exports_and_predicts(tmp_path: Path, name: str) -> None:
    fabric = Fabric(accelerator="cpu", devices=1)
    fit(tiny(name), room_data(), tmp_path, fabric, Callback(), max_steps=2)
    done = export_checkpoint(tmp_path / CHECKPOINT, tmp_path / "model.onnx", ExportOptions())
    assert done.card.training["method"] == name
    bilinear = Detail(Upsampling.BILINEAR)
    pipeline = load(tmp_path / "model.onnx", provider="cpu", detail=bilinear)
    frame = Frame(rooms().image(0))
    depth = pipeline.predict(frame).depth
    assert depth.kind is DepthKind.METRIC
    assert depth.values.shape == (frame.height, frame.width)
    generator, checkpoint = load_generator(tmp_path / CHECKPOINT)
    given = prepare(pipeline.card.input, frame)[0]
    with torch.no_grad():
        raw = generator(torch.from_numpy(given))[0].numpy()
    wanted = checkpoint.config.output.codec.decode(raw)
    assert float(np.mean(depth.values)) == pytest.approx(float(wanted.mean()), rel=0.01)
    session = onnxruntime.InferenceSession(tmp_path / "model.onnx")
    (exported,) = session.run(None, {session.get_inputs()[0].name: given})
    np.testing.assert_allclose(exported[0], raw, atol=1e-4)
