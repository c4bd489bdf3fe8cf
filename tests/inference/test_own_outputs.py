"""Masks and fields of view that networks give beside depth."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from helpers.tiny import card_with, tiny_onnx
from onnx import TensorProto, helper, numpy_helper

from depthcli.core.camera import CameraSource, Intrinsics
from depthcli.core.options import DepthMask, UpsamplingOptions
from depthcli.core.types import Frame
from depthcli.errors import InputError, ModelError
from depthcli.inference.pipeline import Pipeline
from depthcli.inference.session import Session
from depthcli.models.catalog import find_model

MASKED = UpsamplingOptions(mask=DepthMask.MODEL)
SKY = {"output": "sky", "threshold": 0.5, "depth_is": "below"}


def pipeline(folder: Path, options: UpsamplingOptions = MASKED, **changes: Any) -> Pipeline:
    """The tiny network, whose map is also its sky, with a field of view of 90 degrees."""
    model = onnx.load_from_string(tiny_onnx())
    graph = model.graph
    graph.node.append(helper.make_node("Identity", ["depth"], ["sky"]))
    graph.node.append(helper.make_node("ReduceMean", ["image"], ["mean"], keepdims=0))
    graph.node.append(helper.make_node("Mul", ["mean", "zero"], ["nothing"]))
    graph.node.append(helper.make_node("Add", ["nothing", "right"], ["view"]))
    graph.initializer.append(numpy_helper.from_array(np.float32(0), "zero"))
    graph.initializer.append(numpy_helper.from_array(np.float32([90]), "right"))
    for name in ("sky", "view"):
        graph.output.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, None))
    (folder / "m.onnx").write_bytes(model.SerializeToString())
    card = card_with({"file": "m.onnx", "onnx.output": "depth", **changes})
    (folder / "card.json").write_text(json.dumps(card))
    return Pipeline(Session(find_model(folder)), options)


def bright_right() -> Frame:
    """Black on the left, white on the right."""
    return Frame(np.repeat(np.uint8([[0, 255]]), 16, axis=1).repeat(24, axis=0))


def test_pixels_of_the_mask_have_no_depth(tmp_path: Path) -> None:
    depth = pipeline(tmp_path, **{"output.mask": SKY}).predict(bright_right()).depth.values
    assert np.isfinite(depth[:, :12]).all()
    assert np.isnan(depth[:, -12:]).all()


def test_the_mask_is_used_only_if_it_is_asked_for(tmp_path: Path) -> None:
    made = pipeline(tmp_path, UpsamplingOptions(), **{"output.mask": SKY})
    assert np.isfinite(made.predict(bright_right()).depth.values).all()


def test_a_model_without_a_mask_has_none_to_use(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        pipeline(tmp_path).predict(bright_right())


def test_an_output_that_the_graph_lacks_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="'clouds'"):
        pipeline(tmp_path, **{"output.mask": {**SKY, "output": "clouds"}})


@pytest.mark.parametrize(
    ("given", "source", "focal_px"),
    [(None, CameraSource.MODEL, 16), (50.0, CameraSource.OPTION, 50)],
)
def test_own_view_scales_metres_where_the_camera_is_unknown(
    tmp_path: Path, given: float | None, source: CameraSource, focal_px: float
) -> None:
    camera = {"focal_px": 10.0, "along": "width", "hfov_output": "view"}
    made = pipeline(tmp_path, UpsamplingOptions(), camera=camera)
    found = made.predict(bright_right(), Intrinsics(given)).depth
    assert (found.provenance.camera_source, found.provenance.focal_px) == (
        source,
        pytest.approx(focal_px),
    )
    columns = made.card.input.width
    assert found.values[0, 0] == pytest.approx(focal_px * columns / 32 / 10)
