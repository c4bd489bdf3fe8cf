"""Exporting a generator to an ONNX graph with folded batch norm and dynamic batch and size."""

import copy
import logging
import warnings
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
from onnxscript import optimizer
from torch import nn

from depthcli.core.arrays import Float32Array
from depthcli.datasets.folders import sample_positions
from depthcli.errors import ParityError, UsageError
from depthcli.inference.providers import ort
from depthcli.inference.transforms import prepare
from depthcli.io.images.read import read_image
from depthcli.io.listing.folder import is_video, list_folder
from depthcli.io.storage.temporary import temporary_folder
from depthcli.models.card import PROMPT_INPUTS, InputSpec
from depthcli.training.networks.encoder import folded_norms
from depthcli.training.networks.prompted import PromptedGenerator

OPSET = 17
IR_VERSION = 8
INPUT, OUTPUT = "image", "depth"
_TRACED_SIZE = (96, 128)
_CORRECTION = "correction"  # scope of what is computed with known depth
# Scopes of convolutions of the correction that may be rounded.
_FEATURES = {"features", "head", "interpolation", "of_below", "of_points", "of_seen"}
_BELIEF = "belief"  # that may not
_KNOWN = 0.02  # share of known depth in comparisons
_MIN_FLOAT16_SIZE = 64  # small tensors, such as biases, gain nothing from half precision


def build_graph(generator: nn.Module, *, opset: int = OPSET) -> onnx.ModelProto:
    """A checked model of a generator, with dynamic batch, height and width, and IR version 8.

    Its inputs are (B, C, H, W) in [-1, 1] and, if it follows known depth, that and its mask.
    """
    network = fold_batch_norm(generator)
    example = torch.zeros(2, _channels(generator), *_TRACED_SIZE)
    inputs = example, *_prompts(network, example)
    model = optimizer.optimize(_trace(network, inputs, opset))
    model.ir_version = min(model.ir_version, IR_VERSION)
    del model.graph.value_info[:]  # of the export tools, which this IR version does not have
    for node in model.graph.node:
        del node.metadata_props[:]
        node.doc_string = ""
    onnx.checker.check_model(model, full_check=True)
    return model


def _prompts(network: nn.Module, images: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Known depth and its mask for images (B, C, H, W), of a network that takes them; else none.

    Of the first of several images, nothing is known.
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


MAX_PICTURES = 64


def quantize(
    model: onnx.ModelProto, batches: Sequence[Float32Array], generator: nn.Module
) -> onnx.ModelProto:
    """Quantize weights (per channel) and activations to int8, in QDQ format.

    Weights use 7 bits: CPUs with AVX2 but without VNNI accumulate in 16 bits, which 8-bit weights
    could overflow. Biases are corrected for what rounding the weights adds on average (Nagel et al.
    2019, Data-free quantization through weight equalization and bias correction). The batches,
    network inputs (1, C, H, W), calibrate the range of activations.
    What is computed with known depth is not rounded, but for features; neither is the output, as
    256 levels would be steps of 1 % of depth.
    """
    names = [given.name for given in model.graph.input]
    inputs = [(batch, *_prompts(generator, torch.from_numpy(batch))) for batch in batches]
    feeds = [dict(zip(names, map(np.asarray, each), strict=True)) for each in inputs]
    exact = _exact_nodes(model)
    with temporary_folder() as folder:
        # By path, as the quantizer moves the weights of a model in memory to a separate file.
        source, path = folder / "float.onnx", folder / "int8.onnx"
        onnx.save(_transposed(with_corrected_biases(model, feeds, exact), exact), source)
        logging.disable(logging.WARNING)  # the advice to preprocess the model, which has been done
        try:
            quantize_static(
                source,
                path,
                _CalibrationReader(feeds),
                quant_format=QuantFormat.QDQ,
                per_channel=True,
                reduce_range=True,
                activation_type=QuantType.QUInt8,
                weight_type=QuantType.QInt8,
                nodes_to_exclude=exact,
            )
        finally:
            logging.disable(logging.NOTSET)
        return _simplified(onnx.load(path), exact)


def _simplified(model: onnx.ModelProto, exact: Collection[str]) -> onnx.ModelProto:
    """An int8 model without operators that add nothing to its output.

    A shape is that of the rounded tensor, exact nodes read the input before it is rounded, and
    rounding clips to the range that was seen, which is that of clipping or less.
    """
    graph = model.graph
    inputs = {given.name for given in graph.input}
    made = {node.output[0]: node for node in graph.node if node.output}
    for node in graph.node:
        source = made.get(node.input[0]) if node.input else None
        if source is None:
            continue
        if source.op_type == "DequantizeLinear":
            before = made[source.input[0]].input[0] if source.input[0] in made else ""
            if node.op_type == "Shape":
                node.input[0] = source.input[0]
            elif node.name in exact and before in inputs:
                node.input[0] = before
        elif (source.op_type, node.op_type) == ("Clip", "QuantizeLinear"):
            node.input[0] = source.input[0]
    read = {name for node in graph.node for name in node.input} | {o.name for o in graph.output}
    for node in [node for node in graph.node if read.isdisjoint(node.output)]:
        graph.node.remove(node)
    return model


def _exact_nodes(model: onnx.ModelProto) -> list[str]:
    """Names of the nodes that correct depth, but for features, and that give it."""
    names, exact, read = _last_nodes(model), {*PROMPT_INPUTS}, set[str]()
    for node in model.graph.node:
        scopes = {scope.partition(".")[0] for scope in node.name.split("/")}
        if _CORRECTION not in scopes:
            continue
        is_feature = node.op_type in ("Conv", "Relu") and not _FEATURES.isdisjoint(scopes)
        is_sum = node.op_type in ("Add", "Relu") and exact.isdisjoint(node.input)
        if not (is_feature or is_sum) or _BELIEF in scopes:
            exact.update(node.output)
            read.update(node.input)
            if node.op_type != "Clip":
                names.append(node.name)
    own = [
        n for n in model.graph.node if _CORRECTION not in n.name and not read.isdisjoint(n.output)
    ]
    return names + [node.name for node in own]


def _last_nodes(model: onnx.ModelProto) -> list[str]:
    """Names of the last convolution and of what follows it."""
    made = {name: node for node in model.graph.node for name in node.output}
    names, node = [], made.get(OUTPUT)
    while node is not None:
        names.append(node.name)
        is_last = node.op_type in ("Conv", "ConvTranspose")
        node = None if is_last else made.get(node.input[0])
    return names


def _transposed(model: onnx.ModelProto, exact: Collection[str]) -> onnx.ModelProto:
    """The model, whose exact convolutions to one channel are transposed, which gives the same.

    onnxruntime pads the output of a convolution to 16 channels, but not of a transposed one.
    """
    stored = {tensor.name: tensor for tensor in model.graph.initializer}
    for conv in model.graph.node:
        if conv.name not in exact or conv.op_type != "Conv" or conv.input[1] not in stored:
            continue
        weight = numpy_helper.to_array(stored[conv.input[1]])
        if len(weight) > 1:
            continue
        flipped = np.ascontiguousarray(weight.transpose(1, 0, 2, 3)[..., ::-1, ::-1])
        stored[conv.input[1]].CopyFrom(numpy_helper.from_array(flipped, conv.input[1]))
        conv.op_type = "ConvTranspose"
        pads = next(attribute for attribute in conv.attribute if attribute.name == "pads").ints
        pads[:] = [size - 1 - pad for size, pad in zip(2 * weight.shape[2:], pads, strict=True)]
    return model


_LEVELS = 64  # of a weight of 7 bits, on each side of 0


def with_corrected_biases(
    model: onnx.ModelProto, feeds: Sequence[dict[str, Float32Array]], exact: Collection[str] = ()
) -> onnx.ModelProto:
    """The network, whose biases take off the mean of what rounding the weights to 7 bits adds.

    Weights of the nodes named ``exact`` are not rounded.
    """
    stored = {tensor.name: tensor for tensor in model.graph.initializer}
    convs = [
        node
        for node in model.graph.node
        if node.op_type == "Conv"
        and node.input[2:]
        and {*node.input[1:]} <= {*stored}
        and node.name not in exact
    ]
    means = _input_means(model, sorted({conv.input[0] for conv in convs}), feeds)
    corrected = onnx.ModelProto()
    corrected.CopyFrom(model)
    biases = corrected.graph.initializer
    nodes = {node.output[0]: node for node in corrected.graph.node}
    for conv in convs:
        weight, bias = (numpy_helper.to_array(stored[name]) for name in conv.input[1:3])
        step = np.abs(weight).max(axis=(1, 2, 3), keepdims=True) / _LEVELS
        step = np.maximum(step, np.finfo(np.float32).tiny)
        added = ((np.rint(weight / step) * step - weight).sum((2, 3))).astype(np.float32)
        mean = means[conv.input[0]]
        groups = next((a.i for a in conv.attribute if a.name == "group"), 1)
        mean = np.repeat(mean.reshape(groups, -1), len(weight) // groups, axis=0)
        shift = (added * mean).sum(1).astype(bias.dtype)
        # Equal biases of several convolutions are one tensor.
        name = nodes[conv.output[0]].input[2] = f"{conv.output[0]}_bias"
        biases.append(numpy_helper.from_array(bias - shift, name))
    used = {name for node in corrected.graph.node for name in node.input}
    for tensor in [tensor for tensor in biases if tensor.name not in used]:
        biases.remove(tensor)
    return corrected


def _input_means(
    model: onnx.ModelProto, names: Sequence[str], feeds: Sequence[dict[str, Float32Array]]
) -> dict[str, Float32Array]:
    """Mean of each channel of tensors (B, C, H, W) over all batches, by name."""
    probed = onnx.ModelProto()
    probed.CopyFrom(model)
    inner = [name for name in names if name not in feeds[0]]
    probed.graph.output.extend(
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, None) for name in inner
    )
    session = ort.InferenceSession(probed.SerializeToString(), providers=["CPUExecutionProvider"])
    sums: dict[str, Float32Array] = {}
    for feed in feeds:
        seen = session.run(inner, feed) if inner else []  # no names stand for all outputs
        found = feed | dict(zip(inner, seen, strict=True))
        for name in names:
            sums[name] = sums.get(name, np.float32(0)) + found[name].mean((0, 2, 3)) / len(feeds)
    return sums


def calibration_batches(folder: Path, spec: InputSpec) -> list[Float32Array]:
    """Network inputs of up to 64 pictures of a folder and its subfolders, spread evenly by name."""
    listed = list_folder(str(folder)).media
    files = sorted(Path(file.path) for file in listed if not is_video(file.name))
    if not files:
        raise UsageError(f"{folder} has no picture; give one with pictures to calibrate int8")
    positions = sample_positions(len(files), MAX_PICTURES)
    return [prepare(spec, read_image(files[i]))[0] for i in positions]


class _CalibrationReader(CalibrationDataReader):  # type: ignore[misc]
    def __init__(self, feeds: list[dict[str, Float32Array]]) -> None:
        self._feeds = iter(feeds)

    def get_next(self) -> dict[str, Float32Array] | None:
        """Next input, or None at the end."""
        return next(self._feeds, None)


TOLERANCE = 1e-3
FLOAT16_TOLERANCE = 2e-2
INT8_TOLERANCE = 2e-1


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
    pictures: Sequence[Float32Array] = (),
) -> Parity:
    """Compare torch with onnxruntime on noise and on smooth pictures, (batch, height, width).

    Given pictures, (B, C, H, W), are used instead for int8, which is accurate for real ones only.
    """
    session = ort.InferenceSession(model, providers=["CPUExecutionProvider"])
    names = [given.name for given in session.get_inputs()]
    channels = session.get_inputs()[0].shape[1]
    largest, worst_mean = 0.0, 0.0
    for case in cases:
        for batch in pictures or _inputs(*case, channels):
            images = torch.from_numpy(batch)
            inputs = images, *_prompts(network, images)
            with torch.no_grad():
                wanted = network(*inputs).numpy()
            feed = {name: tensor.numpy() for name, tensor in zip(names, inputs, strict=True)}
            (found,) = session.run(None, feed)
            difference = np.abs(found - wanted)
            # A NaN must not pass a comparison.
            largest = max(largest, float(np.nan_to_num(difference.max(), nan=np.inf)))
            worst_mean = max(worst_mean, float(difference.mean()))
    if largest > tolerance:
        raise ParityError(
            f"torch and onnxruntime differ by up to {largest:.2g}, more than {tolerance:g}; "
            "nothing was written"
        )
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
