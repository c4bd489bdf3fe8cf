"""Sessions: the provider asked for or an error, and clear words for a model that does not fit."""

import json
import os
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import onnx.parser
import pytest
from helpers.tiny import card_with, tiny_onnx, write_model

from depthcli.core.parallel import usable_cores
from depthcli.errors import ModelError
from depthcli.inference.session import Session
from depthcli.models.card import ModelCard
from depthcli.models.catalog import find_model

CORES = usable_cores()


@pytest.mark.parametrize("threads", [None, 0, -1, CORES, CORES + 1])
def test_threads_spin_if_their_number_is_given_and_there_are_cores(
    model_folder: Path, threads: int | None
) -> None:
    loaded = Session(find_model(model_folder), threads=threads)
    assert loaded.provider == "cpu"
    with pytest.raises(RuntimeError) if threads in {0, -1, CORES} else nullcontext():  # not set
        options = loaded._session.get_session_options()
        assert options.get_session_config_entry("session.intra_op.allow_spinning") == "0"


def test_a_size_that_does_not_fit_is_an_error(tmp_path: Path) -> None:
    session = Session(find_model(write_model(tmp_path, input__dynamic=False)))
    with pytest.raises(ModelError):
        session.run(np.zeros((1, 1, 5, 5), np.float32))


def test_stopped_session_runs_no_more(model_folder: Path) -> None:
    first, prompted = (Session(find_model(model_folder)) for _ in range(2))
    first.load_known_depth = lambda: prompted
    ended: list[Session] = []
    first.on_stop = lambda: ended.append(first)
    assert first.known_depth is prompted
    first.stop()
    assert ended == [first]
    for stopped in (first, prompted):
        with pytest.raises(ModelError):
            stopped.run(np.zeros((1, 1, 4, 4), np.float32))


def test_an_ir_newer_than_onnxruntime_is_an_error(tmp_path: Path) -> None:
    proto = onnx.load_from_string(tiny_onnx(card=json.dumps(card_with({}))))
    proto.ir_version = 999
    (tmp_path / "m.onnx").write_bytes(proto.SerializeToString())
    with pytest.raises(ModelError, match=r"cannot load .* IR version: 999") as caught:
        Session(find_model(tmp_path / "m.onnx"))
    assert "\n" not in str(caught.value)


def graph(inputs: str, outputs: str, body: str) -> onnx.ModelProto:
    """A network in onnx's language."""
    head = '<ir_version: 8, opset_import: ["": 17]>'
    return onnx.parser.parse_model(f"{head} made ({inputs}) => ({outputs}) {{ {body} }}")


@pytest.mark.parametrize(
    ("shape", "count"),
    [((6, 8), 1), *(((n, *more), n) for more in ((6, 8), (1, 6, 8), (6, 8, 1)) for n in (1, 2))]
    + [(shape, 0) for shape in ((48,), (1, 48), (6, 8, 1), (1, 4, 4, 3), (1, 3, 4, 4))],
)
def test_an_output_is_one_map_an_image(tmp_path: Path, shape: tuple[int, ...], count: int) -> None:
    """That of a single one may be without its axis; whatever else it is, is an error."""
    body = f"shape = Constant<value_ints = {list(shape)}>() depth = Reshape(image, shape)"
    network = graph("float[n,1,h,w] image", "float[] depth", body).SerializeToString()
    session = Session(find_model(write_model(tmp_path, network)))
    batch = np.arange(48 * (count or 1), dtype=np.float32).reshape(-1, 1, 6, 8)
    if count:
        np.testing.assert_array_equal(session.run(batch), batch[:, 0])
        return
    with pytest.raises(ModelError, match="not one depth map an image"):
        session.run(batch)


@pytest.mark.parametrize(
    "inputs",
    [
        "float[n,1,h] image, float[n,3,3] matrix",
        "double[n,1,h,w] image, float[n,3,3] matrix",
        "float[n,1,h,w] image, float[n,3,3] camera",
        "float[n,3,3] matrix, float[n,1,h,w] image",
    ],
)
def test_inputs_other_than_those_of_the_card_are_an_error(tmp_path: Path, inputs: str) -> None:
    network = graph(inputs, "float[] depth", "depth = Cast<to = 1>(image)").SerializeToString()
    model = find_model(write_model(tmp_path, network, input__camera_matrix="matrix"))
    with pytest.raises(ModelError, match=r"has the inputs .*; export it with one float32 input"):
        Session(model)


def _with_outputs(*outputs: tuple[str, int]) -> bytes:
    """A graph whose outputs are its input times a factor, (N, 1, H, W), and their means."""
    nodes = """
        NAME_factor = Constant<value_float = FACTOR.0>()
        NAME = Mul(image, NAME_factor)
        NAME_pool = GlobalAveragePool(NAME)
        NAME_mean = Flatten(NAME_pool)"""
    body = "".join(nodes.replace("NAME", n).replace("FACTOR", str(by)) for n, by in outputs)
    both = ", ".join(f"float[n, 1] {name}_mean, float[n,1,h,w] {name}" for name, _ in outputs)
    return graph("float[n,1,h,w] image", both, body).SerializeToString()


@pytest.mark.parametrize(
    ("names", "card", "factor"),
    [
        (("depth",), {}, 1),
        (("sky", "depth"), {}, 2),
        (("sky", "predicted_depth", "edges"), {}, 2),
        (("disparity", "depth"), {"onnx__output": "depth"}, 2),
        (("sky", "edges"), {"onnx__output": "sky"}, 1),
    ],
)
def test_the_depth_map_of_several_outputs(
    tmp_path: Path, names: tuple[str, ...], card: dict[str, str], factor: int
) -> None:
    graph = _with_outputs(*((name, i + 1) for i, name in enumerate(names)))
    batch = np.arange(48, dtype=np.float32).reshape(1, 1, 6, 8)
    model = find_model(write_model(tmp_path, graph, **card))
    np.testing.assert_array_equal(Session(model).run(batch), factor * batch[:, 0])
    assert ModelCard.from_json(model.card.to_json()) == model.card
    assert ('"output": "' in model.card.to_json()) is bool(card)


@pytest.mark.parametrize(
    ("names", "card", "message"),
    [
        (("sky", "edges"), {}, "state which of them is the depth map in the card, as onnx.output"),
        (("disparity", "depth"), {}, "state which of them is the depth map"),
        (("depth", "edges"), {"onnx__output": "Depth"}, "state one of them in the card"),
    ],
)
def test_the_depth_map_is_not_guessed(
    tmp_path: Path, names: tuple[str, ...], card: dict[str, str], message: str
) -> None:
    graph = _with_outputs(*((name, 1) for name in names))
    with pytest.raises(ModelError, match=message) as caught:
        Session(find_model(write_model(tmp_path, graph, **card)))
    assert all(f"{name} [" in str(caught.value) for name in names)


def test_loading_prints_nothing_and_only_switches_telemetry_off(model_folder: Path) -> None:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("ORT_")}
    code = (
        "import os; before = dict(os.environ); import sys\n"
        "from depthcli.models.catalog import find_model\n"
        "from depthcli.inference.session import Session\n"
        "Session(find_model(sys.argv[1]))\n"
        "assert dict(os.environ) == before | {'ORT_DISABLE_TELEMETRY': '1'}"
    )
    command = [sys.executable, "-c", code, str(model_folder)]
    done = subprocess.run(command, capture_output=True, check=True, env=environment)
    assert (done.stdout, done.stderr) == (b"", b"")


def random_network(kind: str) -> onnx.ModelProto:
    """Two convolutions of random weights, RGB to depth, with numbers of a type of onnx."""
    body = """
        a = Conv<pads = [1, 1, 1, 1]>(image, first)
        b = Relu(a)
        depth = Conv<pads = [1, 1, 1, 1]>(b, second)"""
    model = graph(f"{kind}[n,3,height,width] image", f"{kind}[n,1,height,width] depth", body)
    random = np.random.default_rng(0)
    for name, shape in (("first", (8, 3, 3, 3)), ("second", (1, 8, 3, 3))):
        weights = random.normal(0, 0.3, shape).astype({"float": "f4", "float16": "f2"}[kind])
        model.graph.initializer.append(onnx.numpy_helper.from_array(weights, name))
    return model


def test_networks_in_half_floats_and_int8_give_the_depth_of_floats(tmp_path: Path) -> None:
    from onnxruntime.quantization import QuantType, quantize_dynamic  # noqa: PLC0415 - slow

    plain, small = tmp_path / "plain.onnx", tmp_path / "small.onnx"
    onnx.save(random_network("float"), plain)
    quantize_dynamic(plain, small, weight_type=QuantType.QUInt8)
    assert {node.op_type for node in onnx.load(small).graph.node} >= {"ConvInteger"}
    half = random_network("float16").SerializeToString()
    files = {"float": plain.read_bytes(), "half": half, "int8": small.read_bytes()}
    batch = np.random.default_rng(1).normal(size=(2, 3, 12, 16)).astype(np.float32)
    depths = {}
    for name, data in files.items():
        colours = {"input__colour": "rgb", "input__mean": [0], "input__std": [1]}
        folder = write_model(tmp_path / name, data, **colours)
        depths[name] = Session(find_model(folder), provider="cpu").run(batch)
        assert (depths[name].dtype, depths[name].shape) == (np.float32, (2, 12, 16))
    spread = depths["float"].std()
    assert np.abs(depths["half"] - depths["float"]).max() < 0.01 * spread
    assert np.abs(depths["int8"] - depths["float"]).max() < 0.2 * spread
