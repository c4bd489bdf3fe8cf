"""A tiny model and a synthetic image, made when a test needs them."""

import copy
import hashlib
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx.parser
from onnx import TensorProto, helper

from depthcli.api.depth_map import DepthMap
from depthcli.api.model import load_model
from depthcli.core import types
from depthcli.inference.pipeline import Pipeline
from depthcli.models.card import PROMPT_INPUTS

CARD: dict[str, Any] = {
    "schema": 1,
    "name": "tiny",
    "version": "1.0.0",
    "summary": "A model for tests: bright is far.",
    "license": "MIT",
    "input": {
        "colour": "value",
        "width": 16,
        "height": 12,
        "dynamic": True,
        "multiple_of": 1,
        "fit": "stretch",
        "mean": [0.5],
        "std": [0.5],
    },
    "output": {
        "kind": "metric",
        "transform": "linear",
        "scale": 4.0,
        "shift": 5.0,
        "min_m": 0.5,
        "max_m": 10.0,
    },
    "camera": None,
    "onnx": {"opset": 17, "ir": 8},
}
"""depth = 5 + 4 * (2 V - 1): black is 1 m, white is 9 m."""


def card_with(changes: dict[str, Any]) -> dict[str, Any]:
    """The tiny card with some fields changed; ``"input.width"`` reaches into a section."""
    card = copy.deepcopy(CARD)
    for path, value in changes.items():
        *sections, name = path.split(".")
        section = card
        for key in sections:
            section = section[key]
        section[name] = value
    return card


def tiny_onnx(
    *,
    channels: int = 1,
    stride: int = 1,
    size: tuple[int, int] | None = None,
    card: str | None = None,
) -> bytes:
    """A network whose output is the mean of its input's channels, at 1/stride of its size."""
    height, width = size or ("height", "width")
    weight = np.full((1, channels, stride, stride), 1 / (channels * stride**2), np.float32)
    node = helper.make_node("Conv", ["image", "weight"], ["depth"], strides=[stride, stride])
    graph = helper.make_graph(
        [node],
        "tiny",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, ["n", channels, height, width])],
        [helper.make_tensor_value_info("depth", TensorProto.FLOAT, None)],
        [onnx.numpy_helper.from_array(weight, "weight")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    if card is not None:
        helper.set_model_props(model, {"depthcli.card": card})
    return model.SerializeToString()


def prompted_onnx() -> bytes:
    """The tiny network with known depth and its mask as inputs: that where there is some."""
    model = onnx.load_from_string(tiny_onnx())
    shape = ["n", 1, "height", "width"]
    for name in PROMPT_INPUTS:
        model.graph.input.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, shape))
    model.graph.node[0].output[0] = "plain"
    model.graph.node.append(helper.make_node("Cast", ["mask"], ["known"], to=TensorProto.BOOL))
    model.graph.node.append(helper.make_node("Where", ["known", "prompt", "plain"], ["depth"]))
    return model.SerializeToString()


def known_depth_onnx() -> bytes:
    """A network whose output is the known depth that it takes, whatever the image."""
    model = onnx.load_from_string(tiny_onnx())
    shape = ["n", 1, "rows", "columns"]
    model.graph.input.append(helper.make_tensor_value_info("lidar", TensorProto.FLOAT, shape))
    model.graph.node[0].CopyFrom(helper.make_node("Identity", ["lidar"], ["depth"]))
    return model.SerializeToString()


def fixed_inside(height: int = 12) -> bytes:
    """The tiny network with a reshape that suits one height only."""
    model = onnx.load_from_string(tiny_onnx())
    shape = onnx.numpy_helper.from_array(np.array([1, 1, height, 16]), "shape")
    model.graph.initializer.append(shape)
    node = model.graph.node[0]
    node.output[0] = "free"
    model.graph.node.append(helper.make_node("Reshape", ["free", "shape"], ["depth"]))
    return model.SerializeToString()


def write_model(folder: Path, data: bytes | None = None, **changes: object) -> Path:
    """A folder with a tiny model and its card; fields are changed as in :func:`card_with`.

    In a keyword, two underscores stand for the dot.
    """
    card = card_with({name.replace("__", "."): value for name, value in changes.items()})
    if data is None:
        fixed = (
            None if card["input"]["dynamic"] else (card["input"]["height"], card["input"]["width"])
        )
        data = tiny_onnx(channels=3 if card["input"]["colour"] == "rgb" else 1, size=fixed)
    sums = {"file": "model.onnx", "sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.onnx").write_bytes(data)
    (folder / "card.json").write_text(json.dumps({**sums, **card}))
    return folder


def synthetic_image(height: int = 48, width: int = 64) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """(H, W, 3) uint8 RGB: brightness grows to the right, colour changes downwards."""
    rows, columns = np.mgrid[0:height, 0:width]
    bright = 255 * columns / (width - 1)
    tint = 0.5 + 0.5 * rows / (height - 1)
    return np.stack([bright, bright * tint, bright * (1.5 - tint) / 1.5], axis=-1).astype(np.uint8)


def write_image(path: Path, pixels: np.ndarray[Any, Any] | None = None) -> Path:
    """Write RGB or gray pixels, by default the synthetic image, in the suffix's format."""
    pixels = synthetic_image() if pixels is None else pixels
    path.parent.mkdir(parents=True, exist_ok=True)
    ok, data = cv2.imencode(path.suffix, pixels[..., ::-1] if pixels.ndim == 3 else pixels)
    assert ok
    path.write_bytes(data.tobytes())
    return path


def load(model: Path | str, **options: Any) -> Pipeline:
    """The pipeline of a model; options as of ``load_model``."""
    return load_model(model, **options).pipeline


def point_cloud(depth: types.DepthMap, focal_px: float, frame: Any = None, **more: Any) -> Any:
    """The points of a map of the inner layers, as of ``DepthMap.to_points``."""
    return DepthMap.of(depth, frame).to_points(focal_px=focal_px, **more)


def endless_onnx() -> bytes:
    """A network that counts to 2^63 before it gives its input back."""
    model = onnx.parser.parse_model("""
        <ir_version: 8, opset_import: ["": 17]>
        endless (float[n, 1, height, width] image) => (float[] depth)
        <int64 times = {9223372036854775807}, bool true = {1}> {
            depth = Loop <body = body (int64 i, bool go, float[] sum) => (bool on, float[] next)
                <float one = {1}> {
                    on = Identity (go)
                    next = Add (sum, one)
                }> (times, true, image)
        }""")
    return model.SerializeToString()
