"""What can be chosen about depth maps and models; free of numpy, so that help texts can list it."""

from dataclasses import dataclass
from enum import StrEnum

from depthcli.errors import UsageError


class Upsampling(StrEnum):
    """How depth gets from the network's size to the picture's."""

    GUIDED = "guided"
    """Edges follow those of the picture."""
    BILINEAR = "bilinear"
    """Between neighbours, without a look at the picture."""


class Weights(StrEnum):
    """Which weights of a training run make its model."""

    AVERAGED = "averaged"
    """Their moving average (``optim.ema``); those of the last step where none is kept."""
    RAW = "raw"
    """Those of the last step."""


class Sensor(StrEnum):
    """How depth of rendered rooms is measured."""

    NONE = "none"
    """It is exact."""
    KINECT = "kinect"
    """With the noise and the holes of a structured-light sensor."""


AUTO_TILE = 0
"""Width of tiles that stands for three quarters of the picture's; see docs/sharpness.md."""
GPU_BATCH = 8
"""Pictures in one run of the network on other providers than the CPU."""
MAX_PIXELS = 250_000_000
"""Larger pictures are refused, where no other limit is given."""
DEPTH_BYTES = 4
"""A pixel of a depth map."""


@dataclass(frozen=True, slots=True)
class Detail:
    """How a network's depth becomes that of a full-size picture.

    Attributes:
        upsampling: how depth gets to the picture's size.
        tile_px: width of tiles in pixels of the picture; None for no tiles, 0 for 3/4 of its width.
        max_memory_bytes: most memory for one picture: its pixels, its depth, all that is between
            and what is done with the depth, beside the program and the model; None for no limit.
        use_bytes: what is done with the depth takes so many bytes a pixel; counts for the limit.
    """

    upsampling: Upsampling = Upsampling.GUIDED
    tile_px: int | None = None
    max_memory_bytes: int | None = None
    use_bytes: int = 0

    def __post_init__(self) -> None:
        """Take plain words too.

        Raises:
            UsageError: a value means nothing.
        """
        if self.upsampling not in tuple(Upsampling):
            names = " or ".join(Upsampling)
            raise UsageError(f"upsampling is {names}, not {self.upsampling!r}")
        object.__setattr__(self, "upsampling", Upsampling(self.upsampling))
        if self.tile_px is not None and self.tile_px < 0:
            raise UsageError(f"tiles of {self.tile_px} pixels cannot be; give their width")


PLAIN = Detail()
"""Guided, in one piece, without a limit."""
