"""Exporting a generator to an ONNX graph with folded batch norm and dynamic batch and size."""

import copy
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from onnxscript import optimizer
from torch import nn

from depthcli.core.types import Float32Array
from depthcli.errors import ParityError
from depthcli.inference.session import ort
from depthcli.io.storage.atomic import temporary_folder
from depthcli.lab.training.networks.encoder import folded_norms
from depthcli.lab.training.networks.prompted import PromptedGenerator
from depthcli.models.card import PROMPT_INPUTS

OPSET = 17
IR_VERSION = 8
INPUT, OUTPUT = "image", "depth"
_TRACED_SIZE = (96, 128)
_KNOWN = 0.02  # share of known depth in comparisons
_MIN_FLOAT16_SIZE = 64  # small tensors, such as biases, gain nothing from half precision
TOLERANCE, FLOAT16_TOLERANCE, INT8_TOLERANCE = 1e-3, 2e-2, 2e-1


def build_graph(generator: nn.Module, *, opset: int = OPSET) -> onnx.ModelProto:
    """A checked model of a generator, with dynamic batch, height and width, and IR version 8."""
    network = fold_batch_norm(generator)
    example = torch.zeros(2, _channels(generator), *_TRACED_SIZE)
    inputs = example, *prompts_for(network, example)
    model = optimizer.optimize(_trace(network, inputs, opset))
    model.ir_version = min(model.ir_version, IR_VERSION)
    del model.graph.value_info[:]  # of the export tools, which this IR version does not have
    for node in model.graph.node:
        del node.metadata_props[:]
        node.doc_string = ""
    onnx.checker.check_model(model, full_check=True)
    return model


def prompts_for(network: nn.Module, images: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Known depth and its mask for images (B, C, H, W), if the network takes them; else nothing.

    The first of several images has no known depth.
    """
    if not isinstance(network, PromptedGenerator):
        return ()
    random = torch.Generator().manual_seed(0)
    prompt, chosen = torch.rand(2, len(images), 1, *images.shape[2:], generator=random)
    mask = (chosen < _KNOWN).float()
    if len(images) > 1:
        mask[0] = 0
    return prompt * mask, mask


def _trace(network: nn.Module, inputs: tuple[torch.Tensor, ...], opset: int) -> onnx.ModelProto:
    """Export a network with torch.

    The tracing exporter is used because the dynamo exporter cannot express sizes that are halved
    and rounded up, as between the encoder and the decoder.
    """
    names = [INPUT, *PROMPT_INPUTS[: len(inputs) - 1]]
    with temporary_folder() as folder, warnings.catch_warnings():
        # The exporter warns of its deprecation; its result is checked here and by parity.
        warnings.simplefilter("ignore")
        path = folder / "model.onnx"
        torch.onnx.export(
            network,
            inputs,
            path,
            input_names=names,
            output_names=[OUTPUT],
            opset_version=opset,
            dynamic_axes={
                **{name: {0: "batch", 2: "height", 3: "width"} for name in names},
                OUTPUT: {0: "batch", 2: "out_height", 3: "out_width"},
            },
            dynamo=False,
        )
        return onnx.load(path)


def fold_batch_norm(network: nn.Module) -> nn.Module:
    """A copy in evaluation mode with each batch norm folded into the convolution before it."""
    return folded_norms(copy.deepcopy(network).float().cpu(), _channels(network))


def _channels(network: nn.Module) -> int:
    return int(getattr(network, "channels", 1))


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


@dataclass(frozen=True, slots=True)
class Parity:
    """Differences between the runtimes, in units of the raw output (range about [-1, 1])."""

    max_abs: float  #: largest absolute difference over all cases
    mean_abs: float  #: mean absolute difference of the worst case
    cases: tuple[tuple[int, int, int], ...]  #: (batch, height, width) of each comparison
    tolerance: float  #: maximum difference allowed


def check_parity(
    network: nn.Module,
    model: bytes,
    cases: tuple[tuple[int, int, int], ...],
    tolerance: float = TOLERANCE,
    images: Sequence[Float32Array] = (),
) -> Parity:
    """Compare torch with onnxruntime on noise and smooth images of cases (batch, height, width).

    Or on images (B, C, H, W), which int8 needs: it is accurate for real ones only.
    """
    session = ort.InferenceSession(model, providers=["CPUExecutionProvider"])
    names = [entry.name for entry in session.get_inputs()]
    channels = session.get_inputs()[0].shape[1]
    largest, worst_mean = 0.0, 0.0
    for case in cases:
        for batch in images or _inputs(*case, channels):
            tensor = torch.from_numpy(batch)
            inputs = tensor, *prompts_for(network, tensor)
            with torch.no_grad():
                expected = network(*inputs).numpy()
            feed = {name: value.numpy() for name, value in zip(names, inputs, strict=True)}
            difference = np.abs(session.run(None, feed)[0] - expected)
            # A NaN must not pass a comparison.
            largest = max(largest, float(np.nan_to_num(difference.max(), nan=np.inf)))
            worst_mean = max(worst_mean, float(difference.mean()))
    if largest > tolerance:
        message = f"torch and onnxruntime differ by up to {largest:.2g}, more than {tolerance:g}"
        raise ParityError(f"{message}; nothing was written")
    return Parity(largest, worst_mean, cases, tolerance)


def _inputs(batch: int, height: int, width: int, channels: int) -> tuple[Float32Array, ...]:
    """Noise, a ramp with a step, and waves; each (batch, channels, height, width) in [-1, 1].

    No constant image: instance norm would amplify rounding errors, which differ between runtimes.
    """
    shape = (batch, channels, height, width)
    noise = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    ramp = np.broadcast_to(np.linspace(-1, 1, width, dtype=np.float32), shape).copy()
    ramp[..., height // 2 :, :] *= -1
    rows, columns = np.mgrid[0:height, 0:width]
    waves = np.sin(rows / 7) * np.cos(columns / 5)
    return noise, ramp, np.broadcast_to(waves.astype(np.float32), shape).copy()
