"""Depth from a network's size to a picture's, with a look at the picture."""

import numpy as np
import numpy.typing as npt

from depthcli.core.bands import row_bands, shrink_bands
from depthcli.core.colour import brightness
from depthcli.core.guided import GuidedMap
from depthcli.core.resize import resize_bilinear
from depthcli.core.types import Frame


def upsample_guided(
    depth: npt.NDArray[np.float32], frame: Frame, *, in_log: bool, reach: int = 1
) -> npt.NDArray[np.float32]:
    """Let edges of depth follow the picture's; see :mod:`depthcli.core.guided`.

    Where the picture is no larger than the map, or the map has holes, it is bilinear.

    Args:
        depth: (h, w) float32 of the whole picture.
        frame: the picture.
        in_log: blend log depth, for which ``depth`` must be greater than 0: an edge then looks the
        same
            near and far.
        reach: pixels of ``depth`` that a pixel of the network's own output is wide.

    Returns:
        (H, W) float32 at the picture's size, within the range of ``depth`` near each pixel.
    """
    height, width = depth.shape
    if frame.width <= width or frame.height <= height or not np.isfinite(depth).all():
        return resize_bilinear(depth, frame.width, frame.height)
    small = shrink_bands(frame.pixels, brightness, width, height)
    fitted = GuidedMap.fit(np.log(depth) if in_log else depth, small, reach)
    values = np.empty((frame.height, frame.width), np.float32)
    for rows in row_bands(frame.width, frame.height):
        band = fitted.rows(brightness(frame.pixels[rows]), rows, frame.height)
        values[rows] = np.exp(band, out=band) if in_log else band
    return values
