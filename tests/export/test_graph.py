"""The exported graph: sizes, float16, int8 and parity."""

import logging
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from helpers.small import ALL, EFFICIENT, RESNET, small_network
from helpers.tiny import synthetic_picture, tiny_onnx, write_picture
from onnx import TensorProto
from onnx.numpy_helper import to_array
from torch import Tensor, nn

from depthcli.core.types import DepthMap
from depthcli.errors import ParityError
from depthcli.export.graph import (
    _inputs,
    build_graph,
    calibration_batches,
    check_parity,
    fold_batch_norm,
    quantize,
    weights_to_float16,
    with_corrected_biases,
)
from depthcli.io.formats.png16 import Png16Writer
from depthcli.models.card import Colour, Fit, InputSpec
from depthcli.training.config import GeneratorConfig
from depthcli.training.networks.efficient import EfficientGenerator
from depthcli.training.networks.prompted import PromptedGenerator

Array = np.ndarray[Any, np.dtype[np.float32]]


def _noise(*shape: int) -> Array:
    return np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)


def _run(model: onnx.ModelProto, image: Array) -> Array:
    session = onnxruntime.InferenceSession(
        model.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    output: Array = session.run(None, {"image": image})[0]
    return output


def _torch(network: torch.nn.Module, image: Array) -> Array:
    with torch.no_grad():
        output: Array = network(torch.from_numpy(image)).numpy()
    return output


@pytest.mark.parametrize("config", ALL.values(), ids=ALL.keys())
def test_computes_what_the_network_computes_at_any_batch_and_size(config: GeneratorConfig) -> None:
    network = small_network(config)
    model = build_graph(network)
    for shape in ((1, 1, 32, 48), (3, 1, 48, 32), (2, 1, 96, 128), (1, 1, 40, 36)):
        wanted = _torch(network, _noise(*shape))
        assert wanted.std() > 0.05
        np.testing.assert_allclose(_run(model, _noise(*shape)), wanted, atol=2e-4)


def test_efficient_network_takes_odd_sizes() -> None:
    network = small_network(EFFICIENT)
    model = build_graph(network)
    for size in ((33, 47), (50, 61), (7, 90)):
        image = _noise(1, 1, *size)
        np.testing.assert_allclose(_run(model, image), _torch(network, image), atol=2e-4)


@pytest.mark.parametrize("config", ALL.values(), ids=ALL.keys())
def test_old_runtimes_can_load_it(config: GeneratorConfig) -> None:
    model = build_graph(small_network(config))
    assert model.ir_version == 8
    assert [(entry.domain, entry.version) for entry in model.opset_import] == [("", 17)]
    assert {node.domain for node in model.graph.node} <= {"", "ai.onnx"}
    assert not any(node.metadata_props for node in model.graph.node)
    assert not model.functions


@pytest.mark.parametrize("config", ALL.values(), ids=ALL.keys())
def test_batch_and_size_are_free_and_channels_are_not(config: GeneratorConfig) -> None:
    graph = build_graph(small_network(config)).graph
    assert [value.name for value in (*graph.input, *graph.output)] == ["image", "depth"]
    for value in (*graph.input, *graph.output):
        batch, channels, height, width = value.type.tensor_type.shape.dim
        assert all(dim.dim_param for dim in (batch, height, width))
        assert channels.dim_value == 1


def test_graph_is_simplified() -> None:
    model = build_graph(small_network(EFFICIENT))
    kinds = {node.op_type for node in model.graph.node}
    assert not kinds & {"BatchNormalization", "Identity", "Constant", "Dropout"}
    convolutions = [m for m in small_network(EFFICIENT).modules() if type(m) is torch.nn.Conv2d]
    found = [node for node in model.graph.node if node.op_type == "Conv"]
    assert len(found) == len(convolutions)


def test_everything_is_in_one_file_that_tells_nothing_of_this_machine() -> None:
    model = build_graph(small_network(RESNET))
    assert all(t.data_location == TensorProto.DEFAULT for t in model.graph.initializer)
    data = model.SerializeToString()
    for path in (Path(__file__).parents[2], Path(torch.__file__).parent, Path.home()):
        assert str(path).encode() not in data or path == Path("/")


def test_folding_leaves_the_network_as_it_was() -> None:
    network = small_network(EFFICIENT).train()
    before = {name: value.clone() for name, value in network.state_dict().items()}
    copy = fold_batch_norm(network)
    assert network.training
    assert not any(isinstance(m, torch.nn.BatchNorm2d) for m in copy.modules())
    torch.testing.assert_close(dict(network.state_dict()), before, rtol=0, atol=0)
    image = _noise(1, 1, 32, 32)
    np.testing.assert_allclose(_torch(copy, image), _torch(network.eval(), image), atol=1e-4)


@pytest.mark.parametrize("config", [EFFICIENT, RESNET], ids=["efficient", "resnet"])
def test_halved_weights_halve_the_file_and_keep_float32_sums(config: GeneratorConfig) -> None:
    image = _noise(2, 1, 32, 48)
    model = build_graph(small_network(config))
    whole, wanted = _weight_bytes(model), _run(model, image)
    weights_to_float16(model)
    onnx.checker.check_model(model, full_check=True)
    assert _weight_bytes(model) < 0.56 * whole
    found = _run(model, image)
    assert found.dtype == np.float32
    difference = np.abs(found - wanted)
    assert 0 < difference.max() < 2e-2
    assert difference.mean() < 2e-3
    # Sums in half precision would leave values that half precision can hold.
    assert not np.array_equal(found, found.astype(np.float16).astype(np.float32))


def test_small_and_whole_numbers_are_not_halved() -> None:
    sizes = {"a": 63, "b": 64}
    weights = [onnx.numpy_helper.from_array(_noise(size), name) for name, size in sizes.items()]
    whole = onnx.numpy_helper.from_array(np.arange(99), "c")
    node = onnx.helper.make_node("Concat", ["a", "b"], ["depth"], axis=0)
    output = onnx.helper.make_tensor_value_info("depth", TensorProto.FLOAT, [None])
    graph = onnx.helper.make_graph([node], "g", [], [output], [*weights, whole])
    opset = onnx.helper.make_opsetid("", 17)
    model = onnx.helper.make_model(graph, opset_imports=[opset], ir_version=8)
    weights_to_float16(model)
    assert [tensor.name for tensor in model.graph.initializer] == ["a", "b_half", "c"]
    session = onnxruntime.InferenceSession(model.SerializeToString())
    kept, halved = np.split(session.run(None, {})[0], [63])
    np.testing.assert_array_equal(kept, _noise(63))
    np.testing.assert_array_equal(halved, _noise(64).astype(np.float16))


def _weight_bytes(model: onnx.ModelProto) -> int:
    return sum(len(onnx.numpy_helper.to_array(t).tobytes()) for t in model.graph.initializer)


@pytest.mark.parametrize("opset", [16, 18, 20])
def test_other_opsets(opset: int) -> None:
    network, image = small_network(EFFICIENT), _noise(1, 1, 32, 32)
    model = build_graph(network, opset=opset)
    assert [entry.version for entry in model.opset_import] == [opset]
    np.testing.assert_allclose(_run(model, image), _torch(network, image), atol=2e-4)


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
    small = quantize(model, batches, network)
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
        assert len(np.unique(b)) > 256  # no steps of depth


@pytest.mark.parametrize("groups", [1, 2])
def test_biases_keep_the_mean_that_rounded_weights_would_shift(groups: int) -> None:
    random = np.random.default_rng(0)
    weight = random.normal(size=(8, 4 // groups, 1, 1)).astype(np.float32)
    batches = [random.random((1, 4, 6, 6), np.float32) for _ in range(3)]
    step = np.abs(weight).max((1, 2, 3), keepdims=True) / 64
    rounded = (np.rint(weight / step) * step).astype(np.float32)

    def means(weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
        convolved = [
            torch.nn.functional.conv2d(*map(torch.from_numpy, (batch, weight, bias)), groups=groups)
            for batch in batches
        ]
        return torch.stack(convolved).mean((0, 1, 3, 4)).numpy()

    bias = np.zeros(8, np.float32)
    node = onnx.helper.make_node("Conv", ["image", "weight", "bias"], ["depth"], group=groups)
    sizes = [
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, None)
        for name in ("image", "depth")
    ]
    stored = [
        onnx.numpy_helper.from_array(weight, "weight"),
        onnx.numpy_helper.from_array(bias, "bias"),
    ]
    graph = onnx.helper.make_graph([node], "one", sizes[:1], sizes[1:], stored)
    model = onnx.helper.make_model(
        graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8
    )
    found = with_corrected_biases(model, [{"image": batch} for batch in batches])
    corrected = to_array(found.graph.initializer[1])
    assert np.abs(means(rounded, bias) - means(weight, bias)).max() > 1e-3
    np.testing.assert_allclose(means(rounded, corrected), means(weight, bias), atol=1e-6)


def test_equal_biases_of_two_convolutions_are_corrected_apart() -> None:
    random = np.random.default_rng(0)
    weights = [random.normal(size=(2, 1, 1, 1)).astype(np.float32) for _ in range(2)]
    nodes = [
        onnx.helper.make_node("Conv", ["image", f"weight{i}", "bias"], [f"depth{i}"])
        for i in range(2)
    ]
    sizes = [
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, None)
        for name in ("image", "depth0", "depth1")
    ]
    stored = [onnx.numpy_helper.from_array(each, f"weight{i}") for i, each in enumerate(weights)]
    stored.append(onnx.numpy_helper.from_array(np.zeros(2, np.float32), "bias"))
    graph = onnx.helper.make_graph(nodes, "two", sizes[:1], sizes[1:], stored)
    model = onnx.helper.make_model(
        graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8
    )
    found = with_corrected_biases(model, [{"image": np.ones((1, 1, 4, 4), np.float32)}]).graph
    biases = {tensor.name: to_array(tensor) for tensor in found.initializer}
    for node, weight in zip(found.node, weights, strict=True):
        step = np.abs(weight).max((1, 2, 3), keepdims=True) / 64
        shift = (weight - np.rint(weight / step) * step).ravel()
        np.testing.assert_allclose(biases[node.input[2]], shift, atol=1e-7)


def test_int8_network_for_known_depth_computes_nothing_that_its_output_does_not_need(
    tmp_path: Path,
) -> None:
    write_picture(tmp_path / "0.png", synthetic_picture())
    base = EfficientGenerator((16,) * 5, (16,) * 4, (1,) * 4, 0.0, norm=True).eval()
    base.head.weight.data.normal_(0, 0.1)
    network = PromptedGenerator(base, (8, 8, 8, 8)).eval()
    batches = calibration_batches(tmp_path, SPEC)
    small = quantize(build_graph(network), batches, network)
    made = {name: node.op_type for node in small.graph.node for name in node.output}
    pairs = {(made.get(name), node.op_type) for node in small.graph.node for name in node.input}
    assert ("QuantizeLinear", "Shape") in pairs
    assert ("DequantizeLinear", "Shape") not in pairs
    assert ("Clip", "QuantizeLinear") not in pairs
    readers = [node.op_type for node in small.graph.node if "image" in node.input]
    assert sorted(readers) == ["QuantizeLinear", "SpaceToDepth"]
    check_parity(network, small.SerializeToString(), ((1, 48, 64),), 0.2, batches)


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


CASES = ((1, 12, 16), (2, 24, 8))


class _Offset(nn.Module):
    """The tiny model, whose output is its input, and something that it does not do."""

    def __init__(self, offset: float) -> None:
        super().__init__()
        self.offset = offset

    def forward(self, x: Tensor) -> Tensor:
        return x + self.offset


class _SizeBakedIn(nn.Module):
    """Tracing fixes what is computed outside torch, so the export is right at one size only."""

    def forward(self, x: Tensor) -> Tensor:
        return x * (float(x.shape[3]) / 128)


class _FirstImageOnly(nn.Module):
    """Wrong for the second picture of a batch alone."""

    def forward(self, x: Tensor) -> Tensor:
        return torch.cat([x[:1], x[1:] + 0.5])


def test_same_network_passes_and_is_measured() -> None:
    network = small_network()
    parity = check_parity(network, build_graph(network).SerializeToString(), ((1, 32, 48),))
    assert 0 < parity.mean_abs < parity.max_abs < 1e-3
    assert parity.cases == ((1, 32, 48),)


def test_difference_is_the_true_difference() -> None:
    parity = check_parity(_Offset(0.25), tiny_onnx(), CASES, tolerance=0.3)
    assert parity.max_abs == pytest.approx(0.25, abs=1e-6)
    assert parity.mean_abs == pytest.approx(0.25, abs=1e-6)


def test_difference_within_the_tolerance_passes() -> None:
    largest = check_parity(_Offset(0.25), tiny_onnx(), CASES, tolerance=1).max_abs
    assert check_parity(_Offset(0.25), tiny_onnx(), CASES, largest).tolerance == largest


@pytest.mark.parametrize("size", [(1, 24, 32), (3, 33, 35)])
def test_inputs_take_up_the_range_of_pictures(size: tuple[int, int, int]) -> None:
    noise, ramp, waves = inputs = _inputs(*size, 1)
    batch, height, width = size
    for picture in inputs:
        assert (picture.shape, picture.dtype) == ((batch, 1, height, width), np.float32)
        assert picture.flags.c_contiguous
        assert 0.9 < picture.max() <= 1
        assert -1 <= picture.min() < 0
        assert picture.std() > 0.2
    assert len(np.unique(noise)) == noise.size
    assert abs(noise.mean()) < 0.3
    for one in ramp[:, 0]:
        np.testing.assert_allclose(one[0], np.linspace(-1, 1, width), atol=1e-6)
        assert [row.tolist() == one[0].tolist() for row in one] == [
            row < height // 2 for row in range(height)
        ]
    assert (waves == waves[:1]).all()


@pytest.mark.parametrize(
    "network",
    [_Offset(0.002), _Offset(float("nan")), _FirstImageOnly(), nn.MaxPool2d(3, 1, 1)],
    ids=["offset", "nan", "second of a batch", "another network"],
)
def test_wrong_network_is_refused(network: nn.Module) -> None:
    with pytest.raises(ParityError):
        check_parity(network, tiny_onnx(), CASES)


def test_size_that_tracing_fixed_is_noticed() -> None:
    network = _SizeBakedIn()
    model = build_graph(network).SerializeToString()
    check_parity(network, model, ((2, 96, 128),))
    with pytest.raises(ParityError):
        check_parity(network, model, ((1, 96, 120),))
