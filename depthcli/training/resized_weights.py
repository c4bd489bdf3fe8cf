"""Weights of an efficient generator for a deeper one, or one with a narrower decoder."""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor, nn

from depthcli.training.networks.efficient import EfficientGenerator, ResidualBlock

StateDict = Mapping[str, Tensor]
_AT_ONCE = 8  # pictures, so that many or large ones need little memory


def resized_weights(
    generator: nn.Module, weights: StateDict, pictures: Callable[[], Tensor]
) -> dict[str, Tensor]:
    """Weights for a generator that has more residual blocks or fewer decoder channels.

    Added blocks start as the identity, so the deeper network predicts the same depth (Chen et al.
    2016, "Net2Net"). Of a decoder layer, the channels that contribute most to the next layer are
    kept: mean activation on the pictures times the L1 norm of the weights that read it.

    Args:
        generator: the network that is to get the weights.
        weights: by name, of another network.
        pictures: gives network inputs (B, 1, H, W) in [-1, 1], once it is known that they are
            needed.

    Returns:
        The weights, resized where that is possible; other differences stay.
    """
    if not isinstance(generator, EfficientGenerator):
        return dict(weights)
    deeper = {**weights, **_identity_blocks(generator, weights)}
    widths = decoder_channels(deeper)
    if not narrows(widths, generator.decoder_channels):
        return deeper
    return _narrower(generator, deeper, widths, pictures())


def decoder_channels(weights: StateDict) -> tuple[int, ...]:
    """Channels of each decoder layer of an efficient generator; empty for other networks."""
    channels: list[int] = []
    while (layer := f"fusions.{len(channels)}.0.weight") in weights:
        channels.append(len(weights[layer]))
    return tuple(channels)


def narrows(before: tuple[int, ...], after: tuple[int, ...]) -> bool:
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
    generator: EfficientGenerator, weights: StateDict, widths: tuple[int, ...], gray: Tensor
) -> dict[str, Tensor]:
    wide = generator.with_decoder(widths)
    try:
        wide.load_state_dict({name: weights[name] for name in wide.state_dict()})
    except (KeyError, RuntimeError):  # other differences, which the caller reports
        return dict(weights)
    narrowed = dict(weights)
    for index, activation in enumerate(_mean_activations(wide.eval(), gray)):
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
def _mean_activations(generator: EfficientGenerator, gray: Tensor) -> list[Tensor]:
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
    for pictures in torch.split(gray, _AT_ONCE):
        generator(pictures)
    for hook in hooks:
        hook.remove()
    return [total / len(gray) for total in sums]
