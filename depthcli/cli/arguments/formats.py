"""Words that ``depthcli predict`` takes, kept apart so that its help needs no numpy."""

from enum import StrEnum


class ExrChannel(StrEnum):
    """Channel names that other programs look for."""

    Z = "Z"
    Y = "Y"
    R = "R"
    DEPTH_Z = "depth.Z"


class Colormap(StrEnum):
    """Colours of a preview."""

    INFERNO = "inferno"
    TURBO = "turbo"
    MAGMA = "magma"
    VIRIDIS = "viridis"
    SPECTRAL = "spectral"
    GRAY = "gray"


class Near(StrEnum):
    """What near looks like."""

    WARM = "warm"
    WHITE = "white"
    BLACK = "black"
