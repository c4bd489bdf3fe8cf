"""Choices for options of depth maps and models; free of numpy, so that help texts can list them."""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Self

from depthcli.errors import UsageError


class Upsampling(StrEnum):
    """How depth is upsampled from the network's size to the picture's."""

    GUIDED = "guided"
    """Edges follow those of the picture."""
    BILINEAR = "bilinear"
    """Bilinear interpolation; the picture is not used."""


class Weights(StrEnum):
    """Which weights of a training run make its model."""

    AVERAGED = "averaged"
    """Their moving average (``optim.ema``); those of the last step if there is no average."""
    RAW = "raw"
    """Those of the last step."""


class Colormap(StrEnum):
    """Colormaps of a preview."""

    INFERNO = "inferno"
    TURBO = "turbo"
    MAGMA = "magma"
    VIRIDIS = "viridis"
    SPECTRAL = "spectral"
    GRAY = "gray"


class Near(StrEnum):
    """Colour of near depth in a preview."""

    WARM = "warm"
    """The warm end of the colormap, or its bright one."""
    WHITE = "white"
    BLACK = "black"


class Sensor(StrEnum):
    """How depth of rendered rooms is measured."""

    NONE = "none"
    """It is exact."""
    KINECT = "kinect"
    """With the noise and the holes of a structured-light sensor."""


AUTO_TILE = 0
"""Tile width that stands for three quarters of the picture's width; see docs/sharpness.md."""
GPU_BATCH = 8
"""Batch size of the network on other providers than the CPU."""
MAX_PIXELS = 250_000_000
"""Larger pictures are refused, unless another limit is given."""
DEPTH_BYTES = 4
"""Bytes of a pixel of a depth map."""


@dataclass(frozen=True, slots=True)
class Detail:
    """How the depth of a full-size picture is made from a network's output.

    Attributes:
        upsampling: how depth is upsampled to the picture's size.
        tile_px: width of tiles in pixels of the picture; None for no tiles, 0 for 3/4 of its width.
        max_memory_bytes: limit of memory for one picture: its pixels, its depth, intermediate
            arrays and writing the depth, but not the program and the model; None for no limit.
        use_bytes: memory of writing the depth, in bytes a pixel; counts towards the limit.
    """

    upsampling: Upsampling = Upsampling.GUIDED
    tile_px: int | None = None
    max_memory_bytes: int | None = None
    use_bytes: int = 0

    def __post_init__(self) -> None:
        """Accept strings for the choices.

        Raises:
            UsageError: a value is not valid.
        """
        if self.upsampling not in tuple(Upsampling):
            names = " or ".join(Upsampling)
            raise UsageError(f"upsampling is {names}, not {self.upsampling!r}")
        object.__setattr__(self, "upsampling", Upsampling(self.upsampling))
        if self.tile_px is not None and self.tile_px < 0:
            raise UsageError(f"tile_px has to be 0 or more, not {self.tile_px}; give a width")

    def without_limits(self) -> Self:
        """The same, without the numbers of bytes if they do not change depth."""
        is_needed = self.tile_px == AUTO_TILE and self.max_memory_bytes is not None
        limit = self.max_memory_bytes if is_needed else None
        return replace(self, max_memory_bytes=limit, use_bytes=0)


DEFAULT_DETAIL = Detail()
"""Guided upsampling, no tiles, no limit."""
