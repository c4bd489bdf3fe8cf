"""The exported graph: sizes, float16 and parity."""

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from helpers.small import ALL, EFFICIENT, RESNET, small_network
from helpers.tiny import tiny_onnx
from onnx import TensorProto
from torch import Tensor, nn

from depthcli.errors import ParityError
from depthcli.export.graph import (
    _inputs,
    build_graph,
    check_parity,
    fold_batch_norm,
    weights_to_float16,
)
from depthcli.training.config import GeneratorConfig

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
