"""Ready cards: each runs a network of the signature that its model is exported with."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import onnx.parser
import pytest
from onnx import TensorProto, helper, numpy_helper

from depthcli.core.types import DepthKind, Frame
from depthcli.errors import UsageError
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import Session
from depthcli.inference.transforms import input_layout
from depthcli.jobs.models import add_model
from depthcli.models.card import Fit, check_command, preprocessing_check
from depthcli.models.catalog import find_model, ready_card, ready_names

pytestmark = pytest.mark.usefixtures("models")

IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))


@dataclass(frozen=True)
class Signature:
    """How a model's ONNX file presents itself; None is a dynamic length.

    ``rank`` is that of the output, ``stride`` its step against the input, ``top`` what the network
    gives for a white image.
    """

    input_name: str
    output_name: str
    size: tuple[int, int] | None
    batch: int | None
    rank: int
    stride: int = 1
    top: float = 1.0


MIDAS = Signature("0", "797", (256, 256), 1, 3)
MIDAS_TORCH = Signature("input", "depth", (256, 256), 1, 3)
ANYTHING = Signature("image", "depth", None, None, 3)
ANYTHING_FIXED = Signature("image", "depth", (518, 518), 1, 3)
HUB = Signature("pixel_values", "predicted_depth", None, None, 3)
METER = Signature("image", "depth", (192, 256), 1, 4, stride=4, top=900)
FASTDEPTH = Signature("input.1", "424", (224, 224), 1, 4)
FASTDEPTH_WIDE = Signature("input.1", "424", (256, 320), 1, 4)

SIGNATURES = {
    "midas-small": [MIDAS],
    "midas-small-torch": [MIDAS_TORCH, Signature("input", "depth", None, None, 3)],
    "meter-nyu": [METER],
    "fastdepth": [FASTDEPTH, FASTDEPTH_WIDE],
}
CASES = [
    (name, signature)
    for name in ready_names()
    if name in SIGNATURES or name.startswith("depth-anything-v2")  # others: test_kept_cards.py
    for signature in SIGNATURES.get(name, [ANYTHING, ANYTHING_FIXED, HUB])
]


def write_network(path: Path, signature: Signature, mean: float = 0.0) -> Path:
    """``top`` times the mean of the channels, plus ``mean``, with a model's names and axes."""
    height, width = signature.size or ("height", "width")
    step = signature.stride
    weight = np.full((1, 3, step, step), signature.top / (3 * step**2), np.float32)
    names = [signature.input_name, "weight", "bias"]
    last = "map" if signature.rank == 3 else signature.output_name
    nodes = [helper.make_node("Conv", names, [last], strides=[step, step])]
    if signature.rank == 3:
        nodes.append(helper.make_node("Squeeze", ["map", "one"], [signature.output_name]))
    batch = signature.batch or "batch"
    shape = [batch, 3, height, width]
    graph = helper.make_graph(
        nodes,
        "made",
        [helper.make_tensor_value_info(signature.input_name, TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info(signature.output_name, TensorProto.FLOAT, None)],
        [
            numpy_helper.from_array(weight, "weight"),
            numpy_helper.from_array(np.float32([mean]), "bias"),
            numpy_helper.from_array(np.int64([1]), "one"),
        ],
    )
    opsets = [helper.make_opsetid("", 13)]
    path.write_bytes(
        helper.make_model(graph, opset_imports=opsets, ir_version=7).SerializeToString()
    )
    return path


def ramp(height: int, width: int) -> np.ndarray:
    """(H, W, 3) uint8: bright to the right."""
    row = np.linspace(0, 255, width).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(row[None, :, None], (height, width, 3)))


@pytest.mark.parametrize(("name", "signature"), CASES)
def test_a_network_of_its_signature_runs(tmp_path: Path, name: str, signature: Signature) -> None:
    file = write_network(tmp_path / "download.onnx", signature)
    model = add_model(file, name)
    pipeline = Pipeline(Session(model, provider="cpu"))
    maps = [pipeline.predict(Frame(ramp(*size))).depth for size in ((48, 64), (64, 48))]
    assert model.card.name == name
    assert (model.card.onnx.opset, model.card.onnx.ir) == (13, 7)
    assert model.card.size_bytes == file.stat().st_size
    assert [m.values.shape for m in maps] == [(48, 64), (64, 48)]
    assert all(m.kind is model.card.output.kind for m in maps)
    left, right = maps[0].values[:, 8].mean(), maps[0].values[:, -8].mean()
    assert left < right


@pytest.mark.parametrize("name", dict(CASES))
def test_a_card_states_its_sources_and_licence(name: str) -> None:
    card = ready_card(name)
    assert card.name == name
    licences = {"MIT", "Apache-2.0", "CC-BY-NC-4.0"}
    assert card.license in licences or card.license.startswith("unclear: ")
    assert all(url.startswith("https://") for url in card.training["sources"])
    assert card.training["notes"]


def test_meter_gets_imagenet_s_mean_and_its_centimetres_become_metres(tmp_path: Path) -> None:
    model = add_model(write_network(tmp_path / "m.onnx", METER), "meter-nyu")
    gray = Frame(np.full((24, 32, 3), 153, np.uint8))
    mean, std = np.array(IMAGENET)
    expected_m = 9 * ((0.6 - mean) / std).mean()  # (x/255 - mean)/std, times 900 cm
    np.testing.assert_allclose(
        Pipeline(Session(model)).predict(gray).depth.values, expected_m, rtol=1e-5
    )


@pytest.mark.parametrize("name", dict(CASES))
def test_a_card_says_how_its_preprocessing_was_verified(tmp_path: Path, name: str) -> None:
    check = preprocessing_check(ready_card(name))
    assert check.verified.endswith(".")
    assert check.run_with_weights == (name == "meter-nyu")
    file = write_network(tmp_path / "m.onnx", dict(CASES)[name])
    added = add_model(file, name, name="mine").card
    assert preprocessing_check(added) == check
    inverse = added.output.kind is DepthKind.INVERSE
    assert check_command(added).endswith("--model mine" + " --align disparity" * inverse)


@pytest.mark.parametrize(
    "training", [{}, {"preprocessing": "yes"}, {"preprocessing": {"run_with_weights": 1}}]
)
def test_a_card_that_says_nothing_of_it_is_a_card(training: dict[str, object]) -> None:
    card = replace(ready_card("fastdepth"), training=training)
    assert preprocessing_check(card) is None


def test_the_graph_s_own_size_is_taken(tmp_path: Path) -> None:
    wide = add_model(write_network(tmp_path / "m.onnx", FASTDEPTH_WIDE), "fastdepth").card.input
    fixed = add_model(
        write_network(tmp_path / "n.onnx", ANYTHING_FIXED), "depth-anything-v2-small"
    ).card.input
    assert (wide.height, wide.width, wide.dynamic) == (256, 320, False)
    assert wide.pixel_aspect == pytest.approx(4 / 3 * 256 / 320)  # it learned images of 4:3
    assert (fixed.height, fixed.width, fixed.dynamic, fixed.fit) == (518, 518, False, Fit.STRETCH)


def test_a_graph_that_runs_in_one_size_only_gets_that_size(tmp_path: Path) -> None:
    file = write_network(tmp_path / "m.onnx", ANYTHING)
    graph = onnx.load(file)
    position = np.zeros((1, 3, 518, 518), np.float32)
    graph.graph.initializer.append(onnx.numpy_helper.from_array(position, "position"))
    conv = graph.graph.node[0]
    graph.graph.node.insert(0, helper.make_node("Add", [conv.input[0], "position"], ["embedded"]))
    conv.input[0] = "embedded"
    onnx.save(graph, file)
    spec = add_model(file, "depth-anything-v2-small").card.input
    assert (spec.height, spec.width, spec.dynamic, spec.fit) == (518, 518, False, Fit.STRETCH)


def test_an_unknown_card_is_refused() -> None:
    with pytest.raises(UsageError):
        ready_card("midas")


@pytest.mark.parametrize("size", [(100_000, 1), (1, 5000), (2000, 100)])
def test_a_long_strip_does_not_fill_the_memory(size: tuple[int, int]) -> None:
    spec = ready_card("depth-anything-v2-small").input
    place = input_layout(spec, *size)
    assert 0 < place.width * place.height <= 2.2 * 16 * spec.width * spec.height
    assert place.width % 14 == place.height % 14 == 0


def test_channels_last_is_a_matter_of_the_card(tmp_path: Path, models: Path) -> None:
    """TensorFlow's converters write (N, H, W, C) in and (N, H, W, 1) out."""
    text = """
        <ir_version: 7, opset_import: ["": 13]>
        last (float[1,256,256,3] image) => (float[1,256,256,1] depth) {
            depth = ReduceMean<axes = [3], keepdims = 1>(image)
        }"""
    file = tmp_path / "last.onnx"
    onnx.save(onnx.parser.parse_model(text), file)
    with pytest.raises(Exception, match=r"correct .* input\.layout"):
        add_model(file, "midas-small")
    assert not list(models.glob("*"))
    card = tmp_path / "card.json"
    text = ready_card("midas-small").to_json()
    card.write_text(text.replace('"resize"', '"layout": "nhwc", "resize"'))
    added = add_model(file, str(card))
    assert find_model("midas-small").card == added.card
    depth = Pipeline(Session(added)).predict(Frame(ramp(256, 256))).depth.values
    np.testing.assert_allclose(depth, ramp(256, 256)[..., 0] / 255, atol=1e-6)
