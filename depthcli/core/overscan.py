"""Depth of pictures whose file has pixels outside the display window, or lacks some inside."""

from dataclasses import replace
from typing import Any

import numpy as np

from depthcli.core.types import DepthMap, Frame
from depthcli.core.windows import Windows, over_window


def masked_to_data_window(depth: DepthMap, windows: Windows | None) -> DepthMap:
    """The same map without depth where the file of its picture has no pixels.

    Args:
        depth: of all pixels of the frame.
        windows: of the frame; None if its file has all of them.
    """
    if windows is None or windows.valid == windows.pixels:
        return depth
    return replace(depth, values=windows.only(windows.valid, depth.values))


def displayed_depth(depth: DepthMap, windows: Windows | None) -> DepthMap:
    """The part of a map that is in the display window.

    Args:
        depth: of all pixels of the frame.
        windows: of the frame; None if all of it is displayed.
    """
    if windows is None or windows.pixels == windows.display:
        return depth
    values = over_window(depth.values, windows.pixels, windows.display)
    return replace(depth, values=values)


def displayed_frame(frame: Frame) -> Frame:
    """A frame without the pixels outside its display window."""
    windows = frame.windows
    if windows is None or windows.pixels == windows.display:
        return frame
    pixels: Any = np.ascontiguousarray(frame.pixels[windows.display.within(windows.pixels)])
    return replace(frame, pixels=pixels, windows=replace(windows, pixels=windows.display))
