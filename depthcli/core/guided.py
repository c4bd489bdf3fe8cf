"""Upsampling of a coarse map so that its edges follow those of a picture.

Around each coarse pixel, the map is taken for a straight line of the picture's brightness; line by
line, the coefficients are brought to the picture's size and applied to the picture itself. Lines
are made steeper first, because a network's edges are blurred.

Source: He, Sun and Tang, "Guided Image Filtering", TPAMI 2013; He and Sun, "Fast Guided Filter",
arXiv:1505.00996. The gain and the range that values keep to are our own.
"""

from functools import partial
from typing import NamedTuple, Self

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.bands import row_bands, shrink_bands
from depthcli.core.colour import brightness
from depthcli.core.resize import resize_bilinear, resize_rows
from depthcli.core.types import Frame

# Chosen on held-out scenes, see docs/sharpness.md: less smoothing copies texture, and more gain
# sharpens what is no edge.
_SMOOTHING = 1e-3  # variance of brightness in [0, 1] below which the map keeps its local mean
_GAIN = 1.5


def upsample_guided(
    depth: npt.NDArray[np.float32], frame: Frame, *, in_log: bool, reach: int = 1
) -> npt.NDArray[np.float32]:
    """Depth at the picture's size, whose edges follow those of the picture.

    Where the picture is no larger than the map, or the map has holes, it is bilinear.

    Args:
        depth: (h, w) float32 of the whole picture.
        frame: the picture.
        in_log: blend log depth, for which ``depth`` must be greater than 0: an edge then looks the
            same near and far.
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


class GuidedMap(NamedTuple):
    """A coarse map, ready to be drawn at any size along a picture."""

    #: (h, w) float32, change of the map with the picture's brightness
    slope: npt.NDArray[np.float32]
    offset: npt.NDArray[np.float32]  #: (h, w) float32, the map where brightness is 0
    low: npt.NDArray[np.float32]  #: (h, w) float32, least value of the map within its reach
    high: npt.NDArray[np.float32]  #: (h, w) float32, largest value of the map within its reach

    @classmethod
    def fit(
        cls, coarse: npt.NDArray[np.float32], guide: npt.NDArray[np.float32], reach: int = 1
    ) -> Self:
        """Find the lines.

        Args:
            coarse: (h, w) float32, finite; any quantity that blends linearly.
            guide: (h, w) float32 in [0, 1], brightness of the picture at the map's size.
            reach: coarse pixels from the middle of a window to its border; a wider one smears
                depth. As many as a pixel of the network's own output is wide.
        """
        mean = partial(_box_mean, reach=reach)
        mean_guide, mean_coarse = mean(guide), mean(coarse)
        # Differences of large numbers lose float32's digits, so the map is taken from its mean.
        centred = np.asarray(coarse - coarse.mean(), np.float32)
        covariance = mean(guide * centred) - mean_guide * mean(centred)
        variance = mean(guide * guide) - mean_guide * mean_guide
        slope = np.asarray(_GAIN * covariance / (variance.clip(0) + _SMOOTHING), np.float32)
        offset = np.asarray(mean_coarse - slope * mean_guide, np.float32)
        window = np.ones((2 * reach + 1,) * 2, np.uint8)
        low, high = cv2.erode(coarse, window), cv2.dilate(coarse, window)
        return cls(mean(slope), mean(offset), np.asarray(low), np.asarray(high))

    def rows(
        self, guide: npt.NDArray[np.float32], rows: slice, height: int
    ) -> npt.NDArray[np.float32]:
        """Some rows, (n, W) float32, of the map at the picture's size, ``height`` rows in all.

        Of their brightness (n, W) float32 in [0, 1]; within the range of the coarse map near each
        pixel.
        """
        width = guide.shape[1]
        slope, offset, low, high = (
            resize_rows(part, width, height, rows)
            for part in (self.slope, self.offset, self.low, self.high)
        )
        values = cv2.multiply(slope, guide, dst=slope)
        values = cv2.add(values, offset, dst=values)
        return np.asarray(cv2.min(cv2.max(values, low, dst=values), high, dst=values))


def _box_mean(values: npt.NDArray[np.float32], reach: int) -> npt.NDArray[np.float32]:
    size = (2 * reach + 1,) * 2
    return np.asarray(cv2.blur(values, size, borderType=cv2.BORDER_REPLICATE))
