"""Reading the pixels of OpenEXR files, and the windows that they are in."""

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import OpenEXR

from depthcli.core.choices import MAX_PIXELS
from depthcli.core.picture_limit import PictureLimit
from depthcli.core.windows import Window, over_window
from depthcli.errors import InputError
from depthcli.io.depth.exr_library import OPENEXR_ERRORS, silenced, stated_rate, utf8_name
from depthcli.io.pictures.decode import read_bytes

_WINDOWS = ("dataWindow", "displayWindow")
_DEEP = (OpenEXR.deepscanline, OpenEXR.deeptile)
_SAMPLE_BYTES, _GRAY_BYTES = 2, 4  # at least, of each channel of a file; of a frame


class StoredChannel(NamedTuple):
    """One channel of a part."""

    pixels: npt.NDArray[Any]  #: (H, W) over the data window: float32, float16 or uint32
    data: Window  #: the data window of its part
    display: Window  #: the display window of its part
    pixel_aspect: float  #: width by height of a pixel, as the header states it
    rate: Fraction | None  #: frames a second, as the header states it; None if it does not

    def over(self, window: Window) -> npt.NDArray[np.float32]:
        """The pixels of a window, (H, W) float32, NaN outside the data."""
        values = np.ascontiguousarray(self.pixels, np.float32)
        left, top = self.data[:2]  # a channel may have fewer columns and rows than its window
        height, width = values.shape
        return over_window(values, Window(left, top, left + width, top + height), window)


def read_exr_channels(
    path: Path, *, name: str | None = None, limit: PictureLimit | None = None
) -> dict[str, StoredChannel]:
    """All channels of all parts, by name.

    In a file of several parts, a part's name precedes the names of its channels.

    Args:
        path: the file.
        name: what messages call it; None for its path.
        limit: windows that are larger are refused before pixels are decoded; None for
            ``MAX_PIXELS``, without advice to change it.

    Raises:
        InputError: missing, damaged, deep, or too large.
    """
    read_bytes(path)
    shown = name or str(path)
    channels: dict[str, StoredChannel] = {}
    problem = "is not an EXR file that can be read"
    try:
        with utf8_name(path) as file, silenced():
            for part in OpenEXR.File(file, header_only=True).parts:
                if part.header["type"] in _DEEP:
                    raise InputError(f"{shown} holds deep data; flatten it first")
                _check_pixel_count(shown, part.header, limit)
            problem = "is damaged: its pixels cannot be read; copy it again"
            parts = OpenEXR.File(file, separate_channels=True).parts
        if not parts or not all(part.channels for part in parts):  # all that becomes of damage
            raise InputError(f"{shown} {problem}")
        for part in parts:
            layer = layer_prefix(part.header, len(parts))
            data, display = (_window(part.header[which]) for which in _WINDOWS)
            aspect, rate = float(part.header["pixelAspectRatio"]), stated_rate(part.header)
            for channel, content in part.channels.items():
                channels[layer + channel] = StoredChannel(
                    content.pixels, data, display, aspect, rate
                )
    except OPENEXR_ERRORS as error:
        raise InputError(f"{shown} {problem}") from error
    return channels


def layer_prefix(header: Mapping[str, Any], part_count: int) -> str:
    """What precedes the names of a part's channels."""
    return f"{header['name']}." if part_count > 1 else ""


def _check_pixel_count(name: str, header: dict[str, Any], limit: PictureLimit | None) -> None:
    least = _SAMPLE_BYTES * len(header["channels"]) + _GRAY_BYTES
    for which, pixel_bytes in zip(_WINDOWS, (least, _GRAY_BYTES), strict=True):
        window = _window(header[which])
        if limit is not None:
            limit.check(name, window.width, window.height, pixel_bytes)
        elif window.width * window.height > MAX_PIXELS:
            claimed = f"{window.width}×{window.height} pixels"
            raise InputError(f"{name} claims {claimed}, more than {MAX_PIXELS:,}")


def _window(corners: tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]) -> Window:
    """A window of a header, which names the first and the last pixel."""
    (left, top), (right, bottom) = (map(int, corner) for corner in corners)
    return Window(left, top, right + 1, bottom + 1)
