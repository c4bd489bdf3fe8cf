"""Init weights from exported models or from checkpoints of other runs."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from depthcli.errors import CheckpointError
from depthcli.models.catalog import find_model
from depthcli.training.checkpoint import Checkpoint, load_generator
from depthcli.training.config.schema import GeneratorConfig
from depthcli.training.initial_coding import check_same_coding
from depthcli.training.provenance import PairIds, ids_of_card, merged_ids
from depthcli.training.resized_weights import decoder_channels, narrows, resized_weights
from depthcli.training.weights_origin import weights_origin

_MIRRORED = "network."  # prefix of weights in a graph that averages with the mirrored picture
_HALF = "_half"  # suffix of float16 weights, which the graph casts to float32
_INT8_NODES = frozenset({"DequantizeLinear", "QLinearConv", "ConvInteger", "MatMulInteger"})
# Names of an exported network's weights end so; graphs have other constants, too.
_WEIGHTS = (".weight", ".bias", "input_gain")


def load_init_weights(
    generator: nn.Module, paths: Sequence[Path], pictures: Callable[[], Tensor]
) -> str:
    """Load the weights of a file, or the mean of those of several, into a generator.

    The mean of networks fine-tuned from the same one is often better than each of them (Wortsman
    et al. 2022, "Model soups").

    Args:
        generator: of the same architecture but for its size, see
            :func:`depthcli.training.resized_weights.resized_weights`; for an exported model,
            without batch norm, which is folded into its weights.
        paths: ONNX files that `depthcli export-onnx` made of floats, or checkpoints; at least one.
        pictures: gives network inputs (B, 1, H, W) in [-1, 1], by which the decoder channels to
            keep are chosen.

    Returns:
        The origin of the weights, as of :func:`~depthcli.training.weights_origin.weights_origin`.

    Raises:
        CheckpointError: a file cannot be read, or holds other networks or, for a mean, weights of
            another coding.
    """
    stored = _mean_weights(paths)
    generator.load_state_dict(
        _fitting(resized_weights(generator, stored, pictures), generator, paths)
    )
    return weights_origin(paths)


def narrowed_decoder(
    config: GeneratorConfig, paths: Sequence[Path]
) -> tuple[tuple[int, ...], tuple[int, ...]] | None:
    """Decoder channels of init weights and of the network, if they are narrowed to these.

    Args:
        config: of the network.
        paths: as for :func:`load_init_weights`; none is fine.

    Raises:
        CheckpointError: a file cannot be read.
    """
    if not paths or config.name != "efficient":
        return None
    before = decoder_channels(_weights_of(paths[0]))
    return (before, config.decoder) if narrows(before, config.decoder) else None


def _mean_weights(paths: Sequence[Path]) -> dict[str, Tensor]:
    found = [_weights_of(path) for path in paths]
    shapes = [{name: value.shape for name, value in each.items()} for each in found]
    for path, other in zip(paths, shapes, strict=True):
        if other != shapes[0]:
            raise CheckpointError(
                f"{path} and {paths[0]} are different networks, whose weights have no mean: "
                "start from one of them"
            )
    check_same_coding(paths)
    return {
        name: torch.stack([each[name] for each in found]).double().mean(0) for name in shapes[0]
    }


def _fitting(
    weights: dict[str, Tensor], generator: nn.Module, paths: Sequence[Path]
) -> dict[str, Tensor]:
    wanted = generator.state_dict()
    missing = [
        name
        for name, now in wanted.items()
        if name not in weights or weights[name].shape != now.shape
    ]
    surplus = [name for name in weights if name not in wanted]
    if missing or surplus:
        lack = f"no weights for {missing[0]}" if missing else f"further weights ({surplus[0]})"
        raise CheckpointError(
            f"{paths[0]} has {lack}: set generator.* as they were when it was trained, with "
            "generator.norm=none for an exported float model; generator.depths may be greater, "
            "and generator.decoder smaller"
        )
    return weights


def _weights_of(path: Path) -> dict[str, Tensor]:
    return _of_onnx(path) if path.suffix == ".onnx" else _of_checkpoint(path)


def _of_onnx(path: Path) -> dict[str, Tensor]:
    try:
        graph = onnx.load(path, load_external_data=False).graph
        arrays = {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}
    except Exception as error:  # a file that is not ONNX can raise anything
        raise CheckpointError(
            f"{path} is not a complete ONNX file with embedded weights"
        ) from error
    if any(node.op_type in _INT8_NODES for node in graph.node):
        raise CheckpointError(
            f"{path} has int8 weights, from which no training can start: give its checkpoint, or "
            "the same model in floats"
        )
    plain = {
        name.removeprefix(_MIRRORED).removesuffix(_HALF): values for name, values in arrays.items()
    }
    return {
        name: torch.from_numpy(values.astype(np.float32))
        for name, values in plain.items()
        if name.endswith(_WEIGHTS)
    }


def _of_checkpoint(path: Path) -> dict[str, Tensor]:
    generator, _ = load_generator(path)
    return dict(generator.state_dict())


def seen_by_files(paths: Sequence[Path]) -> PairIds:
    """Ids of the pairs that the weights of any file were trained on, by data set.

    Args:
        paths: checkpoints and exported models; none is fine. The card of a model states its pairs
            of NYU Depth v2 only.

    Raises:
        CheckpointError: a checkpoint cannot be read.
        ModelError: a model cannot be read.
    """
    return merged_ids(
        ids_of_card(find_model(path).card)
        if path.suffix == ".onnx"
        else Checkpoint.load(path).provenance.seen_ids
        for path in paths
    )
