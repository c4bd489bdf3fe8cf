"""Exporting a generator to an ONNX graph with folded batch norm and dynamic batch and size."""

import copy
import warnings

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
_MIN_FLOAT16_SIZE = 64  # small tensors, such as biases, gain nothing from half precision


def build_graph(
    generator: nn.Module, *, opset: int = OPSET, mirror: bool = False
) -> onnx.ModelProto:
    """Export a generator, (B, 1, H, W) in [-1, 1] to raw (B, 1, h, w).

    Returns:
        A checked model with dynamic batch, height and width, and IR version 8. With ``mirror``, it
        averages with the prediction for the mirrored picture, at twice the cost.
    """
    network = fold_batch_norm(generator)
    if mirror:
        network = MirrorAverage(network)
    model = optimizer.optimize(_trace(network, opset))
    model.ir_version = min(model.ir_version, IR_VERSION)
    _strip_metadata(model.graph)
    onnx.checker.check_model(model, full_check=True)
    return model


def _trace(network: nn.Module, opset: int) -> onnx.ModelProto:
    """Export a network with torch.

    The tracing exporter is used because the dynamo exporter cannot express sizes that are halved
    and rounded up, as between the encoder and the decoder.
    """
    with temporary_folder() as folder, warnings.catch_warnings():
        # The exporter warns of its deprecation; its result is checked here and by parity.
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
    """Remove metadata of the export tools, which this IR version does not have."""
    del graph.value_info[:]
    for node in graph.node:
        del node.metadata_props[:]
        node.doc_string = ""


class MirrorAverage(nn.Module):
    """Mean of a network's output and the mirrored output for the mirrored input."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Raw output (B, 1, h, w) for x (B, 1, H, W)."""
        plain: torch.Tensor = self.network(x)
        mirrored = self.network(torch.flip(x, [3]))
        return (plain + torch.flip(mirrored, [3])) / 2


def fold_batch_norm(network: nn.Module) -> nn.Module:
    """A copy in evaluation mode with each batch norm folded into the convolution before it."""
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


def weights_to_float16(model: onnx.ModelProto) -> None:
    """Store large weights as float16, cast to float32 in the graph: half the file size."""
    graph = model.graph
    casts = []
    for i, tensor in enumerate(graph.initializer):
        values = numpy_helper.to_array(tensor)
        if tensor.data_type != TensorProto.FLOAT or values.size < _MIN_FLOAT16_SIZE:
            continue
        name = tensor.name
        half = numpy_helper.from_array(values.astype(np.float16), f"{name}_half")
        graph.initializer[i].CopyFrom(half)
        casts.append(helper.make_node("Cast", [half.name], [name], to=TensorProto.FLOAT))
    nodes = [*casts, *graph.node]
    del graph.node[:]
    graph.node.extend(nodes)
