"""What can be chosen about depth maps; free of numpy, so that help texts can list it."""

from __future__ import annotations

from enum import StrEnum


class Upsampling(StrEnum):
    """How depth gets from the network's size to the picture's."""

    GUIDED = "guided"
    """Edges follow those of the picture."""
    BILINEAR = "bilinear"
    """Between neighbours, without a look at the picture."""
