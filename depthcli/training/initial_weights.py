"""Initial weights from exported models or from checkpoints of other runs."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from depthcli.datasets import id_ranges
from depthcli.datasets.splits import NYU, TRAIN_IDS
from depthcli.errors import CheckpointError
from depthcli.models.catalog import find_model
from depthcli.training.checkpoint import Checkpoint, load_generator

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


def trained_ids(paths: Sequence[Path], data: str, ids: Sequence[str]) -> tuple[str, ...]:
    """Those of the ids of a data set whose pairs the weights of any file were trained on.

    Args:
        paths: as for :func:`start_from`; none is fine.
        data: name of the data set, as in model cards.
        ids: of its pairs.

    Raises:
        CheckpointError: a checkpoint cannot be read.
        ModelError: a model cannot be read.
    """
    seen = {name for path in paths for name in _trained_on(path, data)}
    return tuple(name for name in ids if name in seen)


def _trained_on(path: Path, data: str) -> set[str]:
    is_nyu = data.startswith(NYU)
    if path.suffix == ".onnx":
        stated = str(find_model(path).card.training.get(TRAIN_IDS, "")) if is_nyu else ""
        try:
            return {f"{number:04d}" for number in id_ranges.parse(stated)}
        except ValueError:  # ``training`` in a card is free-form
            return set()
    progress = Checkpoint.load(path).progress
    is_same = progress.data == data or (is_nyu and progress.data.startswith(NYU))
    return {*progress.train_ids, *progress.start_ids} if is_same else set()


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
