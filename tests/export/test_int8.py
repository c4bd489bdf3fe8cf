"""int8: smaller, close to the floats on pictures like those it was calibrated on."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np
import onnxruntime
import pytest
from helpers.tiny import synthetic_picture, write_picture
from onnx.numpy_helper import to_array

from depthcli.core.types import DepthMap
from depthcli.export.graph import build_graph, calibration_batches, quantize
from depthcli.io.formats.png16 import Png16Writer
from depthcli.models.card import Colour, Fit, InputSpec
from depthcli.training.networks.efficient import EfficientGenerator

if TYPE_CHECKING:
    from pathlib import Path

SPEC = InputSpec(Colour.VALUE, 64, 48, True, 4, Fit.STRETCH, (0.5,), (0.5,))


def test_int8_is_smaller_and_close(tmp_path: Path) -> None:
    for shift in range(4):
        pixels = np.roll(synthetic_picture(), 9 * shift, axis=1)
        write_picture(tmp_path / f"{shift}.png", pixels)
    (tmp_path / "notes.txt").write_text("no picture")
    network = EfficientGenerator((32,) * 5, (32,) * 4, (1,) * 4, 0.0, norm=True).eval()
    network.head.weight.data.normal_(0, 0.1)
    model = build_graph(network)
    batches = calibration_batches(tmp_path, SPEC)
    assert len(batches) == 4
    small = quantize(model, batches)
    assert small.ByteSize() < 0.5 * model.ByteSize()
    weights = [w for w in map(to_array, small.graph.initializer) if w.dtype == np.int8]
    assert max(np.abs(w.astype(int)).max() for w in weights) <= 64  # 7 of the 8 bits
    assert sum(w.ndim == 1 and w.size > 1 for w in weights) > 0  # zero points of channels
    assert any(w.dtype == np.uint8 for w in map(to_array, small.graph.initializer))  # activations
    assert not logging.root.manager.disable
    for batch in batches:
        a, b = (
            onnxruntime.InferenceSession(m.SerializeToString()).run(None, {"image": batch})[0]
            for m in (model, small)
        )
        assert 0 < np.abs(a - b).max() < 0.1 * np.ptp(a) + 0.02


@pytest.mark.parametrize("count", [1, 64, 65, 127, 200])
def test_calibration_is_spread_over_all_pictures(tmp_path: Path, count: int) -> None:
    for number in range(count):
        write_picture(tmp_path / f"{number:03}.png", np.full((48, 64, 3), number, np.uint8))
    seen = [round((batch.mean() + 1) * 127.5) for batch in calibration_batches(tmp_path, SPEC)]
    assert (len(seen), seen[0], seen[-1]) == (min(count, 64), 0, count - 1)
    assert len(seen) == 1 or max(np.diff(seen)) <= -(-count // 64) + 1


def test_calibration_takes_subfolders(tmp_path: Path) -> None:
    for number, name in enumerate(("b/0.png", "a.png", "b/c/1.png", "a/9.png")):
        write_picture(tmp_path / "rgb" / name, np.full((48, 64, 3), number, np.uint8))
    batches = calibration_batches(tmp_path / "rgb", SPEC)
    assert [round((batch.mean() + 1) * 127.5) for batch in batches] == [3, 1, 0, 2]


def test_calibration_takes_neither_outputs_nor_other_files(tmp_path: Path) -> None:
    for number in range(300):
        (tmp_path / f"{number:03}.json").touch()
    write_picture(tmp_path / "a.png", np.full((48, 64, 3), 9, np.uint8))
    Png16Writer().write(DepthMap(np.ones((48, 64), np.float32)), tmp_path / "a.depth.png")
    (batch,) = calibration_batches(tmp_path, SPEC)
    assert round((batch.mean() + 1) * 127.5) == 9
