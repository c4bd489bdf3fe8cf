"""Rounding an exported network to 8 bits, but for its first block and its output."""

import copy
import logging
from collections.abc import Callable, Collection, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from onnxruntime.quantization import QuantFormat, QuantType, quantize_static
from torch import nn

from depthcli.core.types import Float32Array
from depthcli.errors import UsageError
from depthcli.inference.session import ort
from depthcli.inference.transforms import prepare
from depthcli.io.images.read import read_image
from depthcli.io.listing import list_folder
from depthcli.io.media import is_video
from depthcli.io.storage.atomic import temporary_folder
from depthcli.lab.datasets.folders import sample_positions
from depthcli.lab.export.graph import INPUT, OUTPUT, prompts_for
from depthcli.models.card import PROMPT_INPUTS, InputSpec

_CORRECTION = "correction"  # scope of what is computed with known depth
# Scopes of convolutions of the correction that may be rounded.
_FEATURES = {"features", "head", "interpolation", "of_below", "of_known", "of_seen"}
_BELIEF = "belief"  # that may not
_CHAIN = ("Conv", "Clip", "Relu")  # operators next to the input
_LEVELS = 64  # of a weight of 7 bits, on each side of 0
_LEAST_SHARE = 0.05  # of the largest channel, which each is taken to have
_Feed = dict[str, Float32Array]
MAX_IMAGES = 64


def quantize(
    model: onnx.ModelProto, batches: Sequence[Float32Array], generator: nn.Module
) -> onnx.ModelProto:
    """Quantize weights (per channel) and activations to int8, in QDQ format.

    Weights use 7 bits: CPUs with AVX2 but without VNNI accumulate in 16 bits, which 8-bit weights
    could overflow. Biases are corrected for the rounding of weights (Nagel et al. 2019, Data-free
    quantization through weight equalization and bias correction). The batches, network inputs
    (1, C, H, W), calibrate the range of activations.
    Three parts stay floats: what is computed with known depth, but for features; the output, as
    256 levels would be steps of 1 % of depth; and what is next to the input, where int8 is not
    faster and costs most.
    """
    names = [entry.name for entry in model.graph.input]
    inputs = [(batch, *prompts_for(generator, torch.from_numpy(batch))) for batch in batches]
    feeds = [dict(zip(names, map(np.asarray, each), strict=True)) for each in inputs]
    exact = _exact_nodes(model)
    model = with_own_weights(model)
    equalize(model, feeds)
    correct_biases(model, feeds, exact)
    _transpose(model, exact)
    with temporary_folder() as folder:
        # By path, as the quantizer moves the weights of a model in memory to a separate file.
        source, path = folder / "float.onnx", folder / "int8.onnx"
        onnx.save(model, source)
        logging.disable(logging.WARNING)  # the advice to preprocess the model, which has been done
        try:
            quantize_static(
                source,
                path,
                SimpleNamespace(get_next=partial(next, iter(feeds), None)),
                quant_format=QuantFormat.QDQ,
                per_channel=True,
                reduce_range=True,
                activation_type=QuantType.QUInt8,
                weight_type=QuantType.QInt8,
                nodes_to_exclude=exact,
            )
        finally:
            logging.disable(logging.NOTSET)
        return _simplified(onnx.load(path))


def _simplified(model: onnx.ModelProto) -> onnx.ModelProto:
    """An int8 model without operators that change nothing.

    They take the shape of a rounded tensor, or clip to a wider range than rounding does.
    """
    graph = model.graph
    producers = {node.output[0]: node for node in graph.node if node.output}
    vain = {("DequantizeLinear", "Shape"), ("Clip", "QuantizeLinear")}
    for node in graph.node:
        source = producers.get(node.input[0]) if node.input else None
        if source is not None and (source.op_type, node.op_type) in vain:
            node.input[0] = source.input[0]
    read = {name for node in graph.node for name in node.input} | {o.name for o in graph.output}
    for node in [node for node in graph.node if read.isdisjoint(node.output)]:
        graph.node.remove(node)
    return model


def _exact_nodes(model: onnx.ModelProto) -> list[str]:
    """Names of the nodes that correct depth, but for features, and of the first and the last."""
    names = _first_nodes(model) + _last_nodes(model)
    exact, read = {*PROMPT_INPUTS}, set[str]()
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
    sources = (n for n in model.graph.node if _CORRECTION not in n.name)
    return names + [node.name for node in sources if not read.isdisjoint(node.output)]


def _first_nodes(model: onnx.ModelProto, start: str = INPUT) -> list[str]:
    """Names of the first convolution, of a depthwise separable one after it, and of activations.

    Likewise those of an input that is made smaller first.
    """
    names, convolutions, name = list[str](), 0, start
    for node in model.graph.node:
        if node.op_type == "AveragePool" and start in node.input:
            names += [node.name, *_first_nodes(model, node.output[0])]
    while True:
        node = next((n for n in model.graph.node if name in n.input and n.op_type in _CHAIN), None)
        if node is None:
            return names
        if node.op_type == "Conv":
            is_separable = convolutions == 2 or (convolutions == 1 and _groups(node) > 1)  # noqa: PLR2004
            if convolutions and not is_separable:
                return names
            convolutions += 1
        names.append(node.name)
        name = node.output[0]


def _groups(conv: onnx.NodeProto) -> int:
    return next((attribute.i for attribute in conv.attribute if attribute.name == "group"), 1)


def _last_nodes(model: onnx.ModelProto) -> list[str]:
    """Names of the last convolution and of what follows it."""
    producers = {name: node for node in model.graph.node for name in node.output}
    names, node = list[str](), producers.get(OUTPUT)
    while node is not None:
        names.append(node.name)
        if node.op_type in ("Conv", "ConvTranspose"):
            break
        node = producers.get(node.input[0])
    return names


def with_own_weights(model: onnx.ModelProto) -> onnx.ModelProto:
    """A copy whose convolutions share no weights or biases: equal ones are one tensor at first."""
    copied = copy.deepcopy(model)
    stored = _stored(copied)
    for node in copied.graph.node:
        for position in range(1, len(node.input) if node.op_type == "Conv" else 0):
            if node.input[position] in stored:
                tensor = copied.graph.initializer.add()
                tensor.CopyFrom(stored[node.input[position]])
                node.input[position] = tensor.name = f"{node.output[0]}_{position}"
    used = {name for node in copied.graph.node for name in node.input}
    for tensor in [tensor for tensor in copied.graph.initializer if tensor.name not in used]:
        copied.graph.initializer.remove(tensor)
    return copied


def _stored(model: onnx.ModelProto) -> dict[str, onnx.TensorProto]:
    return {tensor.name: tensor for tensor in model.graph.initializer}


def _set(tensor: onnx.TensorProto, values: Float32Array) -> None:
    contiguous = np.ascontiguousarray(values, np.float32)
    tensor.CopyFrom(numpy_helper.from_array(contiguous, tensor.name))


def equalize(model: onnx.ModelProto, feeds: Sequence[_Feed]) -> None:
    """Scale channels to an equal range, where the weights that follow can take the scale back.

    That is after a convolution and ReLU, if only dense convolutions read the channels, also
    enlarged or as the first of a concatenation. An encoder's are ten times as large as a decoder's:
    with a common scale, those would have few levels.
    """
    stored = _stored(model)
    producers = {name: node for node in model.graph.node for name in node.output}
    scaled = []
    for relu in model.graph.node:
        conv = producers.get(relu.input[0]) if relu.op_type == "Relu" else None
        if conv is not None and conv.op_type == "Conv" and {*conv.input[1:]} <= {*stored}:
            after = _convolutions_after(relu.output[0], model, stored)
            if after:
                scaled.append((conv, relu.output[0], after))
    read = {conv.output[0]: {n.input[0] for n in after} for conv, _, after in scaled}
    names = {output for _, output, _ in scaled}.union(*read.values())
    largest = _reduced(model, names, feeds, lambda x: np.abs(x).max((0, 2, 3)), np.maximum)
    for conv, output, after in scaled:
        whole = max(largest[name].max() for name in read[conv.output[0]])
        if not whole:
            continue
        scale = whole / np.maximum(largest[output], _LEAST_SHARE * whole)
        for name in conv.input[1:]:
            values = numpy_helper.to_array(stored[name])
            _set(stored[name], values * scale.reshape(-1, *[1] * (values.ndim - 1)))
        for consumer in after:
            weight = numpy_helper.to_array(stored[consumer.input[1]]).copy()
            weight[:, : len(scale)] /= scale.reshape(-1, 1, 1)
            _set(stored[consumer.input[1]], weight)


def _convolutions_after(
    name: str, model: onnx.ModelProto, stored: Collection[str]
) -> list[onnx.NodeProto]:
    """Dense convolutions whose first channels are a tensor; none if anything else reads it."""
    consumers = []
    for node in model.graph.node:
        if name not in node.input or node.op_type == "Shape":
            continue
        is_first = node.input[0] == name
        is_dense = node.op_type == "Conv" and _groups(node) == 1
        if is_first and is_dense and node.input[1] in stored:
            consumers.append(node)
        elif is_first and node.op_type in ("Concat", "Resize"):
            after = _convolutions_after(node.output[0], model, stored)
            if not after:
                return []
            consumers += after
        else:
            return []
    return consumers


def correct_biases(
    model: onnx.ModelProto, feeds: Sequence[_Feed], exact: Collection[str] = ()
) -> None:
    """Subtract from biases what rounding weights to 7 bits adds on average, but for exact nodes."""
    stored = _stored(model)
    rounded = (n for n in model.graph.node if n.op_type == "Conv" and n.name not in exact)
    convs = [n for n in rounded if n.input[2:] and {*n.input[1:]} <= {*stored}]
    names = {conv.input[0] for conv in convs}
    sums = _reduced(model, names, feeds, lambda values: values.mean((0, 2, 3)), np.add)
    for conv in convs:
        weight, bias = (numpy_helper.to_array(stored[name]) for name in conv.input[1:3])
        step = np.abs(weight).max(axis=(1, 2, 3), keepdims=True) / _LEVELS
        step = np.maximum(step, np.finfo(np.float32).tiny)
        added = ((np.rint(weight / step) * step - weight).sum((2, 3))).astype(np.float32)
        mean = sums[conv.input[0]] / len(feeds)
        mean = np.repeat(mean.reshape(_groups(conv), -1), len(weight) // _groups(conv), axis=0)
        _set(stored[conv.input[2]], bias - (added * mean).sum(1))


def _reduced(
    model: onnx.ModelProto,
    names: Collection[str],
    feeds: Sequence[_Feed],
    reduce: Callable[[Float32Array], Float32Array],
    combine: Callable[[Float32Array, Float32Array], Float32Array],
) -> dict[str, Float32Array]:
    """Statistics of each channel of tensors (B, C, H, W) over all batches, by name."""
    probed = copy.deepcopy(model)
    inner = sorted(name for name in names if name not in feeds[0])
    probed.graph.output.extend(
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, None) for name in inner
    )
    session = ort.InferenceSession(probed.SerializeToString(), providers=["CPUExecutionProvider"])
    statistics: dict[str, Float32Array] = {}
    for feed in feeds:
        outputs = session.run(inner, feed) if inner else []  # no names stand for all outputs
        values = feed | dict(zip(inner, outputs, strict=True))
        for name in names:
            statistic = reduce(values[name])
            earlier = statistics.get(name)
            statistics[name] = statistic if earlier is None else combine(earlier, statistic)
    return statistics


def _transpose(model: onnx.ModelProto, exact: Collection[str]) -> None:
    """Turn exact convolutions to one channel into transposed ones, which give the same.

    onnxruntime pads the output of a convolution to 16 channels, but not of a transposed one.
    """
    stored = _stored(model)
    for conv in model.graph.node:
        if conv.name not in exact or conv.op_type != "Conv" or conv.input[1] not in stored:
            continue
        weight = numpy_helper.to_array(stored[conv.input[1]])
        if len(weight) > 1:
            continue
        _set(stored[conv.input[1]], weight.transpose(1, 0, 2, 3)[..., ::-1, ::-1])
        conv.op_type = "ConvTranspose"
        pads = next(attribute for attribute in conv.attribute if attribute.name == "pads").ints
        pads[:] = [size - 1 - pad for size, pad in zip(2 * weight.shape[2:], pads, strict=True)]


def calibration_batches(folder: Path, spec: InputSpec) -> list[Float32Array]:
    """Network inputs of up to 64 images of a folder and its subfolders, spread evenly by name."""
    listed = list_folder(str(folder)).media
    files = sorted(Path(file.path) for file in listed if not is_video(file.name))
    if not files:
        raise UsageError(f"{folder} has no image; give one with images to calibrate int8")
    positions = sample_positions(len(files), MAX_IMAGES)
    return [prepare(spec, read_image(files[i]))[0] for i in positions]
