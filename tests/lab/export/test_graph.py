"""The exported graph: sizes, float16 and parity."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from helpers.small import ALL, EFFICIENT, RESNET, run_onnx, small_network
from helpers.tiny import tiny_onnx
from onnx import TensorProto
from torch import Tensor, nn

from depthcli.errors import ParityError
from depthcli.lab.export.graph import build_graph, check_parity, weights_to_float16
from depthcli.lab.training.config import GeneratorConfig
from depthcli.lab.training.networks.efficient import EfficientGenerator

Array = np.ndarray[Any, np.dtype[np.float32]]


def _noise(*shape: int) -> Array:
    return np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)


def _torch(network: torch.nn.Module, image: Array) -> Array:
    with torch.no_grad():
        output: Array = network(torch.from_numpy(image)).numpy()
    return output


@pytest.fixture(scope="module", params=ALL.values(), ids=ALL.keys())
def exported(request: pytest.FixtureRequest) -> tuple[nn.Module, onnx.ModelProto]:
    """A network and its graph, which tests only read."""
    network = small_network(request.param)
    return network, build_graph(network)


def test_computes_what_the_network_computes_at_any_batch_and_size(
    exported: tuple[nn.Module, onnx.ModelProto],
) -> None:
    network, model = exported
    shapes = [(1, 1, 32, 48), (3, 1, 48, 32), (2, 1, 96, 128), (1, 1, 40, 36)]
    shapes += [(1, 1, 33, 47), (1, 1, 7, 90)] * isinstance(network, EfficientGenerator)
    for shape in shapes:
        expected = _torch(network, _noise(*shape))
        assert expected.std() > 0.05
        np.testing.assert_allclose(run_onnx(model, _noise(*shape)), expected, atol=2e-4)


def test_old_runtimes_can_load_it(exported: tuple[nn.Module, onnx.ModelProto]) -> None:
    _, model = exported
    assert model.ir_version == 8
    assert [(entry.domain, entry.version) for entry in model.opset_import] == [("", 17)]
    assert {node.domain for node in model.graph.node} <= {"", "ai.onnx"}
    assert not any(node.metadata_props for node in model.graph.node)
    assert not model.functions


def test_graph_is_simplified() -> None:
    model = build_graph(small_network(EFFICIENT))
    kinds = {node.op_type for node in model.graph.node}
    assert not kinds & {"BatchNormalization", "Identity", "Constant", "Dropout"}
    convolutions = [m for m in small_network(EFFICIENT).modules() if type(m) is torch.nn.Conv2d]
    nodes = [node for node in model.graph.node if node.op_type == "Conv"]
    assert len(nodes) == len(convolutions)


def test_everything_is_in_one_file_that_tells_nothing_of_this_machine() -> None:
    model = build_graph(small_network(RESNET))
    assert all(t.data_location == TensorProto.DEFAULT for t in model.graph.initializer)
    data = model.SerializeToString()
    for path in (Path(__file__).parents[3], Path(torch.__file__).parent, Path.home()):
        assert str(path).encode() not in data or path == Path("/")


@pytest.mark.parametrize("config", [EFFICIENT, RESNET], ids=["efficient", "resnet"])
def test_halved_weights_halve_the_file_and_keep_float32_sums(config: GeneratorConfig) -> None:
    image = _noise(2, 1, 32, 48)
    model = build_graph(small_network(config))
    whole, expected = _weight_bytes(model), run_onnx(model, image)
    weights_to_float16(model)
    onnx.checker.check_model(model, full_check=True)
    assert _weight_bytes(model) < 0.56 * whole
    small = [tensor for tensor in model.graph.initializer if math.prod(tensor.dims) < 64]
    assert small
    assert TensorProto.FLOAT16 not in {tensor.data_type for tensor in small}
    output = run_onnx(model, image)
    assert output.dtype == np.float32
    difference = np.abs(output - expected)
    assert 0 < difference.max() < 2e-2
    assert difference.mean() < 2e-3
    # Sums in half precision would leave values that half precision can hold.
    assert not np.array_equal(output, output.astype(np.float16).astype(np.float32))


def _weight_bytes(model: onnx.ModelProto) -> int:
    return sum(len(onnx.numpy_helper.to_array(t).tobytes()) for t in model.graph.initializer)


@pytest.mark.parametrize("opset", [16, 18, 20])
def test_other_opsets(opset: int) -> None:
    network, image = small_network(EFFICIENT), _noise(1, 1, 32, 32)
    model = build_graph(network, opset=opset)
    assert [entry.version for entry in model.opset_import] == [opset]
    np.testing.assert_allclose(run_onnx(model, image), _torch(network, image), atol=2e-4)


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
    """Wrong for the second image of a batch alone."""

    def forward(self, x: Tensor) -> Tensor:
        return torch.cat([x[:1], x[1:] + 0.5])


def test_difference_is_the_true_difference() -> None:
    parity = check_parity(_Offset(0.25), tiny_onnx(), CASES, tolerance=0.3)
    assert parity.max_abs == pytest.approx(0.25, abs=1e-6)
    assert parity.mean_abs == pytest.approx(0.25, abs=1e-6)


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
