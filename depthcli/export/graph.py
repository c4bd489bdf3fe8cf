"""A generator as one ONNX graph: batch norm folded, any batch and size, one file."""

import copy
import warnings
from collections.abc import Mapping

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from onnxscript import optimizer
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from depthcli.io.storage.temporary_folder import temporary_folder

OPSET = 17
IR_VERSION = 8
INPUT, OUTPUT = "image", "depth"
_TRACED_SIZE = (96, 128)
_SMALLEST_HALVED = 64  # small tensors, such as biases, gain nothing from half precision


def build_graph(
    generator: nn.Module, *, opset: int = OPSET, mirror: bool = False
) -> onnx.ModelProto:
    """Export a generator, (B, 1, H, W) in [-1, 1] to raw (B, 1, h, w).

    Returns:
        A checked model with dynamic batch, height and width, and IR version 8. With ``mirror`` it
        averages with the prediction of the mirrored picture, at twice the cost.
    """
    network = folded(generator)
    if mirror:
        network = MirrorAverage(network)
    model = optimizer.optimize(_traced(network, opset))
    model.ir_version = min(model.ir_version, IR_VERSION)
    _strip_metadata(model.graph)
    onnx.checker.check_model(model, full_check=True)
    return model


def _traced(network: nn.Module, opset: int) -> onnx.ModelProto:
    """What torch makes of a network.

    The tracing exporter is used because torch's other one cannot express that a size rounds up
    when it is halved, as it does between an encoder and a decoder of any size.
    """
    with temporary_folder() as folder, warnings.catch_warnings():
        # The exporter warns of its own future; what it made is checked here and by parity.
        warnings.simplefilter("ignore")
        path = folder / "model.onnx"
        torch.onnx.export(
            network,
            (torch.zeros(2, 1, *_TRACED_SIZE),),
            path,
            input_names=[INPUT],
            output_names=[OUTPUT],
            opset_version=opset,
            dynamic_axes={
                INPUT: {0: "batch", 2: "height", 3: "width"},
                OUTPUT: {0: "batch", 2: "out_height", 3: "out_width"},
            },
            dynamo=False,
        )
        return onnx.load(path)


def _strip_metadata(graph: onnx.GraphProto) -> None:
    """Drop what tools noted on the way: it is no part of the model, nor known to its IR version."""
    del graph.value_info[:]
    for node in graph.node:
        del node.metadata_props[:]
        node.doc_string = ""


class MirrorAverage(nn.Module):
    """Mean of a network's output and its mirrored output for the mirrored input."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Raw (B, 1, h, w) of x (B, 1, H, W)."""
        plain: torch.Tensor = self.network(x)
        mirrored = self.network(torch.flip(x, [3]))
        return (plain + torch.flip(mirrored, [3])) / 2


def folded(network: nn.Module) -> nn.Module:
    """A copy to evaluate in which each convolution has taken up the batch norm behind it."""
    network = copy.deepcopy(network).float().cpu().eval()
    for module in list(network.modules()):
        if not isinstance(module, nn.Sequential):
            continue
        for i in range(len(module) - 1):
            conv, norm = module[i], module[i + 1]
            if isinstance(conv, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                module[i] = fuse_conv_bn_eval(conv, norm)
                module[i + 1] = nn.Identity()
    return network


def halve_weights(model: onnx.ModelProto) -> None:
    """Store large weights as float16 and widen them on loading: half the file, float32 sums."""
    graph = model.graph
    casts = []
    for i, tensor in enumerate(graph.initializer):
        values = numpy_helper.to_array(tensor)
        if tensor.data_type != TensorProto.FLOAT or values.size < _SMALLEST_HALVED:
            continue
        name = tensor.name
        half = numpy_helper.from_array(values.astype(np.float16), f"{name}_half")
        graph.initializer[i].CopyFrom(half)
        casts.append(helper.make_node("Cast", [half.name], [name], to=TensorProto.FLOAT))
    nodes = [*casts, *graph.node]
    del graph.node[:]
    graph.node.extend(nodes)


def set_metadata(model: onnx.ModelProto, values: Mapping[str, str]) -> None:
    """Replace the model's metadata."""
    helper.set_model_props(model, dict(values))
