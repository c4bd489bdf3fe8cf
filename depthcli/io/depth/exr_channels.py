"""Reading the pixels of OpenEXR files, and the windows that they are in."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import OpenEXR

from depthcli.core.choices import MAX_PIXELS
from depthcli.core.picture_limit import PictureLimit
from depthcli.core.windows import Window, over_window
from depthcli.errors import InputError
from depthcli.io.depth.exr_library import OPENEXR_ERRORS, silenced, utf8_name
from depthcli.io.depth.exr_part import ExrPart, header_window
from depthcli.io.pictures.decode import read_bytes

_WINDOWS = ("dataWindow", "displayWindow")
_DEEP = (OpenEXR.deepscanline, OpenEXR.deeptile)
_SAMPLE_BYTES, _GRAY_BYTES = 2, 4  # at least, of each channel of a file; of a frame


class StoredChannel(NamedTuple):
    """One channel of a part."""

    pixels: npt.NDArray[Any]  #: (H, W) over the data window: float32, float16 or uint32
    part: ExrPart  #: what the header of its part states

    def over(self, window: Window) -> npt.NDArray[np.float32]:
        """The pixels of a window, (H, W) float32, NaN outside the data."""
        values = np.ascontiguousarray(self.pixels, np.float32)
        left, top = self.part.data[:2]  # a channel may have fewer columns and rows than its window
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
        first = ExrPart.of(parts[0].header)
        for part in parts:
            layer = f"{part.header['name']}." if len(parts) > 1 else ""
            stated = ExrPart.of(part.header, first)
            for channel, content in part.channels.items():
                channels[layer + channel] = StoredChannel(content.pixels, stated)
    except OPENEXR_ERRORS as error:
        raise InputError(f"{shown} {problem}") from error
    return channels


def _check_pixel_count(name: str, header: dict[str, Any], limit: PictureLimit | None) -> None:
    least = _SAMPLE_BYTES * len(header["channels"]) + _GRAY_BYTES
    for which, pixel_bytes in zip(_WINDOWS, (least, _GRAY_BYTES), strict=True):
        size = header_window(header[which])
        if limit is not None:
            limit.check(name, size.width, size.height, pixel_bytes)
        elif size.width * size.height > MAX_PIXELS:
            claimed = f"{size.width}×{size.height} pixels"
            raise InputError(f"{name} claims {claimed}, more than {MAX_PIXELS:,}")
