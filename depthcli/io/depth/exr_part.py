"""What the header of a part of an OpenEXR file states."""

from collections.abc import Mapping
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from depthcli.core.windows import Window
from depthcli.io.depth.exr_library import stated_rate
from depthcli.io.depth.time_code import stated_time_code

_CHROMATICITIES = 8


class ExrPart(NamedTuple):
    """A part, without its channels."""

    data: Window  #: its data window
    display: Window  #: its display window
    pixel_aspect: float  #: width by height of a pixel
    rate: Fraction | None  #: frames a second; None if they are not stated
    time_code: tuple[int, ...] | None  #: of the frame; None if no valid one is stated
    #: CIE x and y of red, green, blue and white; None if it does not state them
    chromaticities: tuple[float, ...] | None

    @classmethod
    def of(cls, header: Mapping[str, Any], first: "ExrPart | None" = None) -> "ExrPart":
        """What a header states, as OpenEXR reads it.

        A part that states no rate, no time code or no primaries has those of the first part.
        """
        stated: Any = header.get("chromaticities")
        if not (isinstance(stated, tuple) and len(stated) == _CHROMATICITIES):
            stated = first.chromaticities if first else None
        return cls(
            header_window(header["dataWindow"]),
            header_window(header["displayWindow"]),
            float(header["pixelAspectRatio"]),
            stated_rate(header) or (first.rate if first else None),
            stated_time_code(header) or (first.time_code if first else None),
            stated,
        )


def header_window(corners: tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]) -> Window:
    """A window of a header, which names the first and the last pixel."""
    (left, top), (right, bottom) = (map(int, corner) for corner in corners)
    return Window(left, top, right + 1, bottom + 1)
