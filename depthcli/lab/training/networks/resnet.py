"""The generator of the paper, ``resnet_9blocks`` (Johnson et al. 2016), and layers of all GANs.

These are blur (Zhang 2019), instance norm, and the initialization of weights.
"""

from collections.abc import Sequence

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.lab.training.config import GeneratorConfig

_STD = 0.02


class BlurDown(nn.Module):
    """Depthwise [1, 2, 1]² filter with stride 2 and reflection padding."""

    kernel: Tensor

    def __init__(self, channels: int) -> None:
        super().__init__()
        line = torch.tensor([1.0, 2.0, 1.0]) / 4
        kernel = torch.outer(line, line).expand(channels, 1, -1, -1).clone()
        self.register_buffer("kernel", kernel, persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, C, ceil(H/2), ceil(W/2))."""
        x = F.pad(x, (1, 1, 1, 1), mode="reflect")
        return F.conv2d(x, self.kernel.to(x.dtype), stride=2, groups=x.shape[1])


class InstanceNorm(nn.InstanceNorm2d):
    """Instance norm without affine parameters (Ulyanov et al. 2016).

    The gradients of torch's own (2.13 still) are wrong for one image in channels-last memory, so
    its batch norm, which is the same for one image, is used where gradients are needed.
    """

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, C, H, W), each map with mean 0 and variance 1."""
        if len(x) == 1 and (self.training or x.requires_grad):
            return F.batch_norm(x, None, None, training=True, eps=self.eps)
        return super().forward(x)


def init_weights(network: nn.Module, *, xavier: bool) -> None:
    """Kernels from N(0, 0.02²) (CycleGAN), or Xavier-normal of gain 0.02 (CUT); zero biases."""
    for layer in network.modules():
        if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d | nn.Linear):
            if xavier:
                nn.init.xavier_normal_(layer.weight, _STD)
            else:
                nn.init.normal_(layer.weight, 0.0, _STD)
            if layer.bias is not None:
                nn.init.zeros_(layer.bias)


class ResnetGenerator(nn.Module):
    """Image to image of the same size, in [-1, 1].

    Instance norm without affine parameters after every convolution makes it invariant to the
    input's mean and contrast. An image of one channel is repeated for others. The ``residual``
    connection ``stem`` adds the features after the first layer to the last map, ``input`` adds α·x
    before the tanh with α learned.
    """

    TAPS = ("input", "down1", "down2", "block1", "block5")

    def __init__(self, config: GeneratorConfig, channels: int = 1, outputs: int = 1) -> None:
        super().__init__()
        width, antialias, residual = config.width, config.antialias, config.residual
        self.width, self.residual, self.channels = width, residual, channels
        self.pad = nn.ReflectionPad2d(3)
        self.stem = nn.Sequential(nn.Conv2d(channels, width, 7), _norm_relu(width))
        self.down1 = _Down(width, 2 * width, antialias=antialias)
        self.down2 = _Down(2 * width, 4 * width, antialias=antialias)
        self.blocks = nn.ModuleList(_Block(4 * width) for _ in range(config.blocks))
        self.up1 = _up(4 * width, 2 * width, antialias=antialias)
        self.up2 = _up(2 * width, width, antialias=antialias)
        self.head = nn.Sequential(nn.ReflectionPad2d(3), nn.Conv2d(width, outputs, 7))
        init_weights(self, xavier=antialias)
        self.input_gain = nn.Parameter(torch.zeros(())) if residual == "input" else None

    def tap_channels(self, tap: str) -> int:
        """Channels of a named feature map."""
        widths = (self.channels, 2 * self.width, 4 * self.width, 4 * self.width, 4 * self.width)
        return dict(zip(self.TAPS, widths, strict=True))[tap]

    def features(self, x: Tensor, taps: Sequence[str] = TAPS) -> list[Tensor]:
        """Encoder feature maps of x (B, channels or 1, H, W) for the given taps.

        They are the padded input, both downsampling convolutions before their norm, and the
        residual blocks 1 and 5 (or the last).
        """
        maps = {"input": self._padded(x)}
        maps["down1"] = self.down1.conv(self.stem(maps["input"]))
        maps["down2"] = self.down2.conv(self.down1.finish(maps["down1"]))
        y = self.down2.finish(maps["down2"])
        for number, block in enumerate(self.blocks[:5], start=1):
            y = block(y)
            if number == 1:
                maps["block1"] = y
        maps["block5"] = y
        return [maps[tap] for tap in taps]

    def _padded(self, x: Tensor) -> Tensor:
        return self.pad(x.expand(-1, self.channels, -1, -1))  # type: ignore[no-any-return]

    def forward(self, x: Tensor) -> Tensor:
        """(B, channels or 1, H, W) to (B, outputs, H, W); H and W multiples of 4."""
        stem = self.stem(self._padded(x))
        y = self.down2(self.down1(stem))
        for block in self.blocks:
            y = block(y)
        y = self.up2(self.up1(y))
        z = self.head(y + stem if self.residual == "stem" else y)
        if self.input_gain is not None:
            z = z + self.input_gain * x
        return torch.tanh(z)


class _Down(nn.Module):
    """Half the size, twice the channels; ``conv`` can be tapped before its norm."""

    def __init__(self, inputs: int, outputs: int, *, antialias: bool) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, 3, 1 if antialias else 2, 1)
        blur: nn.Module = BlurDown(outputs) if antialias else nn.Identity()
        self.finish = nn.Sequential(_norm_relu(outputs), blur)

    def forward(self, x: Tensor) -> Tensor:
        return self.finish(self.conv(x))  # type: ignore[no-any-return]


class _Block(nn.Module):
    """Two 3×3 convolutions with reflection padding, added to their input."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.ReflectionPad2d(1),
            nn.Conv2d(width, width, 3),
            _norm_relu(width),
            nn.ReflectionPad2d(1),
            nn.Conv2d(width, width, 3),
            InstanceNorm(width),
        )

    def forward(self, x: Tensor) -> Tensor:
        return x + self.body(x)  # type: ignore[no-any-return]


def _up(inputs: int, outputs: int, *, antialias: bool) -> nn.Sequential:
    if antialias:
        # Bilinear at half-pixel centres is the blur [1, 3, 3, 1]² of Zhang 2019.
        grow = nn.Upsample(scale_factor=2, mode="bilinear")
        conv: list[nn.Module] = [grow, nn.Conv2d(inputs, outputs, 3, 1, 1)]
    else:
        conv = [nn.ConvTranspose2d(inputs, outputs, 3, 2, 1, output_padding=1)]
    return nn.Sequential(*conv, _norm_relu(outputs))


def _norm_relu(width: int) -> nn.Sequential:
    return nn.Sequential(InstanceNorm(width), nn.ReLU(inplace=True))
