"""Weights to start from: those of exported models, or of other runs' checkpoints."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from depthcli.errors import CheckpointError
from depthcli.training.checkpoint import load_generator

_HALF = "_half"  # how float16 weights are named that the graph widens
_HASH_LENGTH = 16


def start_from(generator: nn.Module, paths: Sequence[Path]) -> str:
    """Give a generator the weights of a file, or the mean of those of several.

    The mean of networks that were trained on from the same one is often better than each of them
    (Wortsman et al. 2022, "Model soups").

    Args:
        generator: of the same architecture; for an exported model, without batch norm, which is
            folded into its weights.
        paths: ONNX files that `depthcli export-onnx` made of floats, or checkpoints; at least one.

    Returns:
        What the weights are, for a model's card: the files' names and their SHA-256.

    Raises:
        CheckpointError: a file cannot be read or holds other networks.
    """
    found = [_fitting_weights(generator, path) for path in paths]
    means = {
        name: torch.stack([each[name] for each in found]).double().mean(0) for name in found[0]
    }
    generator.load_state_dict(means)
    hashes = [hashlib.sha256(path.read_bytes()).hexdigest()[:_HASH_LENGTH] for path in paths]
    names = [f"{path.name} {digest}" for path, digest in zip(paths, hashes, strict=True)]
    return names[0] if len(names) == 1 else f"mean of {', '.join(names)}"


def _fitting_weights(generator: nn.Module, path: Path) -> dict[str, Tensor]:
    weights = _of_onnx(path) if path.suffix == ".onnx" else _of_checkpoint(path)
    wanted = generator.state_dict()
    strange = [
        name
        for name, now in wanted.items()
        if name not in weights or weights[name].shape != now.shape
    ]
    if strange:
        raise CheckpointError(
            f"{path} has no weights for {strange[0]}: set generator.* as they were when it was "
            "trained, with generator.norm=none for an exported float model"
        )
    return {name: weights[name] for name in wanted}


def _of_onnx(path: Path) -> dict[str, Tensor]:
    try:
        graph = onnx.load(path, load_external_data=False).graph
        arrays = {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}
    except Exception as error:  # what is no graph fails in any way
        raise CheckpointError(f"{path} is not a whole ONNX file in itself") from error
    return {
        name.removesuffix(_HALF): torch.from_numpy(values.astype(np.float32))
        for name, values in arrays.items()
    }


def _of_checkpoint(path: Path) -> dict[str, Tensor]:
    generator, _ = load_generator(path)
    return dict(generator.state_dict())
