"""Initial weights from exported models or from checkpoints of other runs."""

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

_MIRRORED = "network."  # prefix of weights in a graph that averages with the mirrored picture
_HALF = "_half"  # suffix of float16 weights, which the graph casts to float32
_HASH_LENGTH = 16


def start_from(generator: nn.Module, paths: Sequence[Path]) -> str:
    """Load the weights of a file, or the mean of those of several, into a generator.

    The mean of networks fine-tuned from the same one is often better than each of them (Wortsman
    et al. 2022, "Model soups").

    Args:
        generator: of the same architecture; for an exported model, without batch norm, which is
            folded into its weights.
        paths: ONNX files that `depthcli export-onnx` made of floats, or checkpoints; at least one.

    Returns:
        The origin of the weights for a model card: file names and the first 16 digits of SHA-256.

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
    missing = [
        name
        for name, now in wanted.items()
        if name not in weights or weights[name].shape != now.shape
    ]
    if missing:
        raise CheckpointError(
            f"{path} has no weights for {missing[0]}: set generator.* as they were when it was "
            "trained, with generator.norm=none for an exported float model"
        )
    return {name: weights[name] for name in wanted}


def _of_onnx(path: Path) -> dict[str, Tensor]:
    try:
        graph = onnx.load(path, load_external_data=False).graph
        arrays = {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}
    except Exception as error:  # a file that is not ONNX can raise anything
        raise CheckpointError(
            f"{path} is not a complete ONNX file with embedded weights"
        ) from error
    return {
        name.removeprefix(_MIRRORED).removesuffix(_HALF): torch.from_numpy(
            values.astype(np.float32)
        )
        for name, values in arrays.items()
    }


def _of_checkpoint(path: Path) -> dict[str, Tensor]:
    generator, _ = load_generator(path)
    return dict(generator.state_dict())
