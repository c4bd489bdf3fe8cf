"""Weight initialization of each family of methods."""

from torch import nn

_STD = 0.02
_CONVOLUTIONS = (nn.Conv2d, nn.ConvTranspose2d)


def init_normal(network: nn.Module) -> None:
    """Kernels from N(0, 0.02²) and zero biases (CycleGAN)."""
    for layer in network.modules():
        if isinstance(layer, _CONVOLUTIONS):
            nn.init.normal_(layer.weight, 0.0, _STD)
            _zero_bias(layer)


def init_xavier(network: nn.Module) -> None:
    """Xavier-normal kernels and matrices of gain 0.02 and zero biases (CUT)."""
    for layer in network.modules():
        if isinstance(layer, (*_CONVOLUTIONS, nn.Linear)):
            nn.init.xavier_normal_(layer.weight, _STD)
            _zero_bias(layer)


def _zero_bias(layer: nn.Module) -> None:
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)  # type: ignore[arg-type]
