"""Init weights: the weights of exported models or of other runs' checkpoints, to start from."""

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from depthcli.errors import CheckpointError
from depthcli.lab.training.checkpoint import Checkpoint, load_generator
from depthcli.lab.training.networks.encoder import EncoderGenerator
from depthcli.lab.training.networks.prompted import PromptedGenerator
from depthcli.lab.training.provenance import DataProvenance, PairIds, ids_of_card, merged_ids
from depthcli.models.catalog import find_model

HUB = Path("hub")  #: in place of a file: the pretrained encoder that timm downloads
_ENCODER_SUFFIXES = (".pth", ".pt")
_HALF = "_half"  # suffix of float16 weights, which the graph casts to float32
# Names of an exported network's weights end so; graphs have other constants, too.
_WEIGHTS = (".weight", ".bias", "input_gain")
_HASH_LENGTH = 16
_INPUT_SETTINGS = ("width", "height", "colour")


def weights_file(source: Path) -> Path:
    """The checkpoint, or the ONNX file of a model; of an int8 model, that of its float model."""
    if _is_encoder_file(source) or (source.suffix != ".onnx" and source.is_file()):
        return source
    if source.suffix == ".ckpt":
        raise CheckpointError(f"no checkpoint at {source}")
    model = find_model(source)
    return find_model(model.card.float_model).path if model.card.float_model else model.path


def settings_of(source: Path) -> dict[str, Any]:
    """Settings that a network with the layers of another shares with it; a card may lack some."""
    path = weights_file(source)
    if _is_encoder_file(path):
        raise CheckpointError(f"{path} has weights of an encoder, not of a whole network")
    if path.suffix == ".onnx":
        settings, norm = find_model(path).card.training.get("config", {}), {"norm": "none"}
    else:
        settings, norm = asdict(Checkpoint.load(path).config), {}
    generator = {k: v for k, v in settings.get("generator", {}).items() if k != "prompt"}
    inputs = {k: v for k, v in settings.get("data", {}).items() if k in _INPUT_SETTINGS}
    return {"generator": generator | norm, "output": settings.get("output", {}), "data": inputs}


def load_init_weights(
    generator: nn.Module, paths: Sequence[Path], provenance: DataProvenance
) -> DataProvenance:
    """Load the weights of a file, or the mean of those of several, into a generator.

    The mean of networks fine-tuned from the same one is often better than each of them (Wortsman
    et al. 2022, "Model soups"). An exported model needs a generator without batch norm, which is
    folded into its weights; a pretrained encoder (a file, or :data:`HUB`) goes into that of the
    generator. Returns the provenance with the origin of the weights and the pairs they have seen.
    """
    origin = _origin(paths)
    if isinstance(generator, EncoderGenerator) and _is_encoder_file(paths[0]):
        if len(paths) > 1:
            raise CheckpointError(f"{paths[0]} has weights of an encoder, which have no mean")
        generator.load_encoder(None if paths[0] == HUB else paths[0])
        encoder = "timm's hub" if paths[0] == HUB else origin
        return replace(provenance, init_weights=origin, encoder_weights=encoder)
    weights, ids, encoders = zip(*map(_read, paths), strict=True)
    is_prompted = any(name.startswith("correction.") for name in weights[0])
    if isinstance(generator, PromptedGenerator) and not is_prompted:
        generator = generator.base
    try:
        generator.load_state_dict(_mean(weights, paths))
    except RuntimeError as error:
        message = f"{paths[0]} holds another network ({' '.join(str(error).split()[:60])})"
        advice = "set generator.* as it was trained, with norm=none for an exported float model"
        raise CheckpointError(message, advice) from error
    encoder = "; ".join(dict.fromkeys(filter(None, encoders)))
    provenance = replace(provenance, init_weights=origin, init_ids=merged_ids(ids))
    return replace(provenance, encoder_weights=encoder)


def _is_encoder_file(path: Path) -> bool:
    return path == HUB or path.suffix in _ENCODER_SUFFIXES


def _origin(paths: Sequence[Path]) -> str:
    if HUB in paths:
        return str(HUB)
    digests = [hashlib.sha256(path.read_bytes()).hexdigest()[:_HASH_LENGTH] for path in paths]
    names = [f"{path.name} {digest}" for path, digest in zip(paths, digests, strict=True)]
    return f"mean of {', '.join(names)}" if len(names) > 1 else "".join(names)


def _read(path: Path) -> tuple[dict[str, Tensor], PairIds, str]:
    """Weights of a file, the pairs they were trained on, and the origin of their encoder."""
    if path.suffix != ".onnx":
        generator, saved = load_generator(path)
        provenance = saved.provenance
        return dict(generator.state_dict()), provenance.seen_ids, provenance.encoder_weights
    try:
        graph = onnx.load(path, load_external_data=False).graph
        arrays = {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}
    except Exception as error:  # a file that is not ONNX can raise anything
        message = f"{path} is not a complete ONNX file with embedded weights"
        raise CheckpointError(message) from error
    weights = {
        name.removesuffix(_HALF): torch.from_numpy(values.astype(np.float32))
        for name, values in arrays.items()
        if name.removesuffix(_HALF).endswith(_WEIGHTS)
    }
    card = find_model(path).card
    return weights, ids_of_card(card), str(card.training.get("encoder_weights", ""))


def _mean(weights: Sequence[dict[str, Tensor]], paths: Sequence[Path]) -> dict[str, Tensor]:
    shapes = [{name: value.shape for name, value in each.items()} for each in weights]
    for path, other in zip(paths, shapes, strict=True):
        if other != shapes[0]:
            raise CheckpointError(f"{path} and {paths[0]} are different networks without a mean")
    return {
        name: torch.stack([each[name] for each in weights]).double().mean(0) for name in shapes[0]
    }
