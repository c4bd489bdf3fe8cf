"""Rounding an exported network to 8 bits."""

import logging
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from helpers.small import run_onnx
from helpers.tiny import synthetic_image, write_image
from onnx.numpy_helper import to_array
from torch import Tensor, nn

from depthcli.core.types import DepthMap
from depthcli.io.formats.raster import Png16Writer
from depthcli.lab.export.graph import build_graph, check_parity
from depthcli.lab.export.int8 import (
    calibration_batches,
    correct_biases,
    equalize,
    quantize,
    with_own_weights,
)
from depthcli.lab.training.config import GeneratorConfig
from depthcli.lab.training.networks.efficient import EfficientGenerator
from depthcli.lab.training.networks.prompted import PromptedGenerator
from depthcli.models.card import Colour, Fit, InputSpec

SPEC = InputSpec(Colour.VALUE, 64, 48, True, 4, Fit.STRETCH, (0.5,), (0.5,))


def _efficient(width: int) -> EfficientGenerator:
    config = GeneratorConfig(encoder=(width,) * 5, decoder=(width,) * 4, depths=(1,) * 4)
    return EfficientGenerator(config).eval()


def test_int8_is_smaller_and_close(tmp_path: Path) -> None:
    for shift in range(4):
        pixels = np.roll(synthetic_image(), 9 * shift, axis=1)
        write_image(tmp_path / f"{shift}.png", pixels)
    (tmp_path / "notes.txt").write_text("no image")
    network = _efficient(32)
    network.head.weight.data.normal_(0, 0.1)
    model = build_graph(network)
    batches = calibration_batches(tmp_path, SPEC)
    assert len(batches) == 4
    small = quantize(model, batches, network)
    assert small.ByteSize() < 0.5 * model.ByteSize()
    weights = [w for w in map(to_array, small.graph.initializer) if w.dtype == np.int8]
    assert max(np.abs(w.astype(int)).max() for w in weights) <= 64  # 7 of the 8 bits
    assert sum(w.ndim == 1 and w.size > 1 for w in weights) > 0  # zero points of channels
    assert any(w.dtype == np.uint8 for w in map(to_array, small.graph.initializer))  # activations
    assert not logging.root.manager.disable
    for batch in batches:
        a, b = (run_onnx(m, batch) for m in (model, small))
        assert 0 < np.abs(a - b).max() < 0.1 * np.ptp(a) + 0.02
        assert len(np.unique(b)) > 256  # no steps of depth
    assert [node.op_type for node in small.graph.node if "image" in node.input] == ["Conv"]


def _kept(model: onnx.ModelProto) -> list[list[np.ndarray]]:
    """Weights and biases of each convolution."""
    stored = {tensor.name: to_array(tensor) for tensor in model.graph.initializer}
    convolutions = (node for node in model.graph.node if node.op_type == "Conv")
    return [[stored[name] for name in node.input[1:]] for node in convolutions]


def _rounded(weight: np.ndarray) -> np.ndarray:
    step = np.abs(weight).max((1, 2, 3), keepdims=True) / 64
    return np.rint(weight / step) * step


@pytest.mark.parametrize("groups", [1, 2])
def test_biases_keep_the_mean_that_rounded_weights_would_shift(groups: int) -> None:
    torch.manual_seed(0)
    network = nn.Conv2d(4, 8, 1, groups=groups)
    network.channels = 4
    images = torch.rand(3, 1, 4, 6, 6)

    def means(weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
        kernel, added = torch.from_numpy(weight.astype(np.float32)), torch.from_numpy(bias.copy())
        return F.conv2d(images[:, 0], kernel, added, groups=groups).mean((0, 2, 3)).numpy()

    model = with_own_weights(build_graph(network))
    ((weight, bias),) = _kept(model)
    expected, bias = means(weight, bias), bias.copy()
    correct_biases(model, [{"image": image.numpy()} for image in images])
    ((_, corrected),) = _kept(model)
    assert np.abs(means(_rounded(weight), bias) - expected).max() > 1e-3
    np.testing.assert_allclose(means(_rounded(weight), corrected), expected, atol=1e-6)


def test_int8_network_for_known_depth_computes_nothing_that_its_output_does_not_need(
    tmp_path: Path,
) -> None:
    write_image(tmp_path / "0.png", synthetic_image())
    base = _efficient(16)
    base.head.weight.data.normal_(0, 0.1)
    network = PromptedGenerator(base, (8, 8, 8, 8)).eval()
    batches = calibration_batches(tmp_path, SPEC)
    small = quantize(build_graph(network), batches, network)
    writers = {name: node.op_type for node in small.graph.node for name in node.output}
    pairs = {(writers.get(name), node.op_type) for node in small.graph.node for name in node.input}
    assert ("QuantizeLinear", "Shape") in pairs
    assert ("DequantizeLinear", "Shape") not in pairs
    assert ("Clip", "QuantizeLinear") not in pairs
    readers = [node.op_type for node in small.graph.node if "image" in node.input]
    assert sorted(readers) == ["Conv", "SpaceToDepth"]
    check_parity(network, small.SerializeToString(), ((1, 48, 64),), 0.2, batches)


@pytest.mark.parametrize("count", [1, 64, 65, 127, 200])
def test_calibration_is_spread_over_all_images(tmp_path: Path, count: int) -> None:
    for number in range(count):
        write_image(tmp_path / f"{number:03}.png", np.full((48, 64, 3), number, np.uint8))
    levels = [round((batch.mean() + 1) * 127.5) for batch in calibration_batches(tmp_path, SPEC)]
    assert (len(levels), levels[0], levels[-1]) == (min(count, 64), 0, count - 1)
    assert len(levels) == 1 or max(np.diff(levels)) <= -(-count // 64) + 1


def test_calibration_takes_subfolders(tmp_path: Path) -> None:
    for number, name in enumerate(("b/0.png", "a.png", "b/c/1.png", "a/9.png")):
        write_image(tmp_path / "rgb" / name, np.full((48, 64, 3), number, np.uint8))
    batches = calibration_batches(tmp_path / "rgb", SPEC)
    assert [round((batch.mean() + 1) * 127.5) for batch in batches] == [3, 1, 0, 2]


def test_calibration_takes_neither_outputs_nor_other_files(tmp_path: Path) -> None:
    for number in range(300):
        (tmp_path / f"{number:03}.json").touch()
    write_image(tmp_path / "a.png", np.full((48, 64, 3), 9, np.uint8))
    Png16Writer().write(DepthMap(np.ones((48, 64), np.float32)), tmp_path / "a.depth.png")
    (batch,) = calibration_batches(tmp_path, SPEC)
    assert round((batch.mean() + 1) * 127.5) == 9


class _Decoder(nn.Module):
    """Small features beside those of an encoder, which are a hundred times as large."""

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(0)
        self.small, self.large = nn.Conv2d(1, 16, 3, 2, 1), nn.Conv2d(1, 16, 3, 1, 1)
        self.fusion, self.head = nn.Conv2d(32, 16, 3, 1, 1), nn.Conv2d(16, 1, 3, 1, 1)
        self.large.weight.data *= 100
        self.fusion.weight.data[:, 16:] /= 100

    def forward(self, x: Tensor) -> Tensor:
        """(B, 1, H, W) to (B, 1, H, W)."""
        small = F.interpolate(self.small(x).relu(), scale_factor=2.0, mode="bilinear")
        return self.head(self.fusion(torch.cat([small, self.large(x)], 1)).relu())  # type: ignore[no-any-return]


def test_features_beside_larger_ones_keep_their_levels(monkeypatch: pytest.MonkeyPatch) -> None:
    network = _Decoder().eval()
    model = build_graph(network)
    random = np.random.default_rng(0)
    batches = [random.uniform(-1, 1, (1, 1, 32, 32)).astype(np.float32) for _ in range(4)]

    def error(other: onnx.ModelProto) -> float:
        return float(np.std([run_onnx(other, batch) - run_onnx(model, batch) for batch in batches]))

    equal = with_own_weights(model)
    equalize(equal, [{"image": batch} for batch in batches])
    assert error(equal) < 1e-6
    small = error(quantize(model, batches, network))
    monkeypatch.setattr("depthcli.lab.export.int8.equalize", lambda *_: None)
    assert small < 0.5 * error(quantize(model, batches, network))


def test_depthwise_convolutions_are_rounded_as_well() -> None:
    torch.manual_seed(0)
    layers = nn.Conv2d(1, 8, 3), nn.Conv2d(8, 8, 3), nn.Conv2d(8, 8, 3, groups=8)
    network = nn.Sequential(*(layer for conv in layers for layer in (conv, nn.ReLU())))
    network.append(nn.Conv2d(8, 1, 1)).eval()
    image = np.random.default_rng(0).uniform(-1, 1, (1, 1, 32, 32)).astype(np.float32)
    model = build_graph(network)
    exact, rounded = (run_onnx(each, image) for each in (model, quantize(model, [image], network)))
    assert np.abs(rounded - exact).max() < 0.1 * np.ptp(exact)
