"""Encoder-decoders that are fast on CPUs: a decoder for any encoder, and one with its own."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from depthcli.lab.training.config import GeneratorConfig


class DecodingGenerator(nn.Module):
    """Network input to raw depth at half its size, from the feature maps of an encoder.

    Subclasses build their encoder, call :meth:`_add_decoder`, and define :meth:`_encode`.
    """

    TAPS: Sequence[str] = ("stride2", "stride4", "stride8", "stride16")

    def _add_decoder(self, encoder: Sequence[int], config: GeneratorConfig, *, norm: bool) -> None:
        """Build the decoder for the channels of :meth:`_encode`, of which 0 stands for no map."""
        decoder, deepest = config.decoder, encoder[-1]
        self.encoder_channels, self.decoder_channels = tuple(encoder), decoder
        self.whole_picture = nn.Linear(deepest, deepest)
        self.dropout = nn.Dropout2d(config.dropout)
        inner = (deepest, *decoder)
        self.fusions = nn.ModuleList(
            ConvNorm(below + skip, width, norm=norm)
            for below, skip, width in zip(inner, reversed(encoder[:-1]), decoder, strict=False)
        )
        self.head = nn.Conv2d(decoder[-1], 1, 3, padding=1)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)  # type: ignore[arg-type]

    @abstractmethod
    def _encode(self, x: Tensor) -> tuple[list[Tensor | None], Tensor]:
        """Feature maps at strides 2, 4, 8, 16, which may be missing, and at stride 32."""

    def tap_channels(self, tap: str) -> int:
        """Channels of a named feature map."""
        return self.encoder_channels[DecodingGenerator.TAPS.index(tap)]

    def features(self, x: Tensor, taps: Sequence[str] = TAPS) -> list[Tensor]:
        """Encoder feature maps of x (B, C, H, W) for the given taps."""
        maps = dict(zip(DecodingGenerator.TAPS, self._encode(x)[0], strict=True))
        return [features for tap in taps if (features := maps[tap]) is not None]

    def forward(self, x: Tensor) -> Tensor:
        """Raw depth (B, 1, ceil(H/2), ceil(W/2)) of x (B, C, H, W) in [-1, 1]."""
        return self.head(self.maps(x)[1][-1])  # type: ignore[no-any-return]

    def maps(self, x: Tensor) -> tuple[list[Tensor | None], list[Tensor]]:
        """The encoder's maps at strides 2, 4, 8, 16, or None; the decoder's at 32, 16, 8, 4, 2."""
        skips, y = self._encode(x)
        y = y + self.whole_picture(y.mean((2, 3)))[:, :, None, None]
        y = self.dropout(y)
        maps = [y]
        for fusion, skip in zip(self.fusions, reversed(skips), strict=True):
            if skip is None:
                y = fusion(F.interpolate(y, scale_factor=2.0, mode="bilinear"))
            else:
                y = fusion(torch.cat([resized(y, skip), skip], 1))
            maps.append(y)
        return skips, maps


def resized(x: Tensor, like: Tensor) -> Tensor:
    """Bilinear interpolation of x (B, C, H, W) at the height and width of another map."""
    if torch.onnx.is_in_onnx_export():
        return _Resized.apply(x, like)  # type: ignore[no-untyped-call, no-any-return]
    return F.interpolate(x, size=like.shape[2:], mode="bilinear", align_corners=False)


class _Resized(torch.autograd.Function):
    """Four operators in the exported graph in place of ten, most of them of the size."""

    @staticmethod
    def forward(_: Any, x: Tensor, like: Tensor) -> Tensor:  # noqa: ANN401
        return F.interpolate(x, size=like.shape[2:], mode="bilinear", align_corners=False)

    @staticmethod
    def symbolic(graph: Any, x: Any, like: Any) -> Any:  # noqa: ANN401
        shapes = graph.op("Shape", x, end_i=2), graph.op("Shape", like, start_i=2)
        none = graph.op("Constant", value_t=torch.tensor([], dtype=torch.float32))
        sizes = graph.op("Concat", *shapes, axis_i=0)
        resize = graph.op("Resize", x, none, none, sizes, mode_s="linear")
        resize.setType(x.type())
        return resize


class EfficientGenerator(DecodingGenerator):
    """Gray image to raw depth at half its size; convolutions without batch norm have biases."""

    def __init__(self, config: GeneratorConfig) -> None:
        super().__init__()
        encoder, norm = list(map(int, config.encoder)), config.norm == "batch"
        self.stem = ConvNorm(1, encoder[0], stride=2, norm=norm)
        self.stages = nn.ModuleList(
            nn.Sequential(
                ResidualBlock(below, width, stride=2, norm=norm),
                *(ResidualBlock(width, width, norm=norm) for _ in range(depth - 1)),
            )
            for below, width, depth in zip(encoder, encoder[1:], config.depths, strict=False)
        )
        self._add_decoder(encoder, config, norm=norm)

    def _encode(self, x: Tensor) -> tuple[list[Tensor | None], Tensor]:
        maps = [self.stem(x)]
        for stage in self.stages:
            maps.append(stage(maps[-1]))
        return [*maps[:-1]], maps[-1]


class ConvNorm(nn.Sequential):
    """Convolution, optionally batch norm, and ReLU unless disabled."""

    def __init__(
        self,
        inputs: int,
        outputs: int,
        size: int = 3,
        stride: int = 1,
        *,
        norm: bool,
        relu: bool = True,
    ) -> None:
        layers: list[nn.Module] = [
            nn.Conv2d(inputs, outputs, size, stride, size // 2, bias=not norm),
            nn.BatchNorm2d(outputs) if norm else nn.Identity(),
        ]
        if relu:
            layers.append(nn.ReLU(inplace=True))
        super().__init__(*layers)


class ResidualBlock(nn.Module):
    """Two 3×3 convolutions added to their input."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1, *, norm: bool) -> None:
        super().__init__()
        self.body = nn.Sequential(
            ConvNorm(inputs, outputs, stride=stride, norm=norm),
            ConvNorm(outputs, outputs, norm=norm, relu=False),
        )
        self.skip: nn.Module = nn.Identity()
        if inputs != outputs or stride > 1:
            self.skip = ConvNorm(inputs, outputs, 1, stride, norm=norm, relu=False)

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, outputs, H/stride, W/stride)."""
        return F.relu(self.body(x) + self.skip(x))
