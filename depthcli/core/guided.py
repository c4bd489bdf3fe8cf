"""Upsampling of a coarse map so that its edges follow those of a picture.

Around each coarse pixel, the map is modelled as a linear function of the picture's brightness. The
coefficients are upsampled, a few rows at a time, and applied to the picture itself. Slopes are
multiplied by a gain first, because a network's edges are blurred.

Source: He, Sun and Tang, "Guided Image Filtering", TPAMI 2013; He and Sun, "Fast Guided Filter",
arXiv:1505.00996. The gain and the clamping to the local range are our own.
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

# Chosen on held-out scenes, see docs/sharpness.md: less smoothing copies texture into depth, and
# more gain sharpens where there is no edge.
_SMOOTHING = 1e-3  # variance of brightness in [0, 1] below which the map keeps its local mean
_GAIN = 1.5


def upsample_guided(
    depth: npt.NDArray[np.float32], frame: Frame, *, in_log: bool, radius: int = 1
) -> npt.NDArray[np.float32]:
    """Depth at the picture's size, whose edges follow those of the picture.

    It is bilinear if the picture is no larger than the map, or the map has holes.

    Args:
        depth: (h, w) float32 of the whole picture.
        frame: the picture.
        in_log: filter log depth, for which ``depth`` must be greater than 0: edges are then treated
            alike near and far.
        radius: of the filter's window, in pixels of ``depth``: the width of a pixel of the
            network's own output.

    Returns:
        (H, W) float32 at the picture's size, within the range of ``depth`` near each pixel.
    """
    height, width = depth.shape
    if frame.width <= width or frame.height <= height or not np.isfinite(depth).all():
        return resize_bilinear(depth, frame.width, frame.height)
    small = shrink_bands(frame.pixels, brightness, width, height)
    fitted = GuidedMap.fit(np.log(depth) if in_log else depth, small, radius)
    values = np.empty((frame.height, frame.width), np.float32)
    for rows in row_bands(frame.width, frame.height):
        band = fitted.rows(brightness(frame.pixels[rows]), rows, frame.height)
        values[rows] = np.exp(band, out=band) if in_log else band
    return values


class GuidedMap(NamedTuple):
    """Coefficients of a guided filter at a coarse size, to be applied at any larger size."""

    #: (h, w) float32, change of the map with the picture's brightness
    slope: npt.NDArray[np.float32]
    offset: npt.NDArray[np.float32]  #: (h, w) float32, the map where brightness is 0
    low: npt.NDArray[np.float32]  #: (h, w) float32, least value of the map within the radius
    high: npt.NDArray[np.float32]  #: (h, w) float32, largest value of the map within the radius

    @classmethod
    def fit(
        cls, coarse: npt.NDArray[np.float32], guide: npt.NDArray[np.float32], radius: int = 1
    ) -> Self:
        """Fit the coefficients.

        Args:
            coarse: (h, w) float32, finite.
            guide: (h, w) float32 in [0, 1], brightness of the picture at the map's size.
            radius: of the window, in coarse pixels; a larger one blurs depth.
        """
        mean = partial(_box_mean, radius=radius)
        mean_guide, mean_coarse = mean(guide), mean(coarse)
        # Differences of large numbers lose float32's digits, so the mean is subtracted first.
        centred = np.asarray(coarse - coarse.mean(), np.float32)
        covariance = mean(guide * centred) - mean_guide * mean(centred)
        variance = mean(guide * guide) - mean_guide * mean_guide
        slope = np.asarray(_GAIN * covariance / (variance.clip(0) + _SMOOTHING), np.float32)
        offset = np.asarray(mean_coarse - slope * mean_guide, np.float32)
        window = np.ones((2 * radius + 1,) * 2, np.uint8)
        low, high = cv2.erode(coarse, window), cv2.dilate(coarse, window)
        return cls(mean(slope), mean(offset), np.asarray(low), np.asarray(high))

    def rows(
        self, guide: npt.NDArray[np.float32], rows: slice, height: int
    ) -> npt.NDArray[np.float32]:
        """Some rows of the map at the picture's size, clamped to the coarse map's local range.

        Args:
            guide: (n, W) float32 in [0, 1], brightness of these rows of the picture.
            rows: which rows they are.
            height: rows of the picture.

        Returns:
            (n, W) float32.
        """
        width = guide.shape[1]
        slope, offset, low, high = (
            resize_rows(part, width, height, rows)
            for part in (self.slope, self.offset, self.low, self.high)
        )
        values = cv2.multiply(slope, guide, dst=slope)
        values = cv2.add(values, offset, dst=values)
        return np.asarray(cv2.min(cv2.max(values, low, dst=values), high, dst=values))


def _box_mean(values: npt.NDArray[np.float32], radius: int) -> npt.NDArray[np.float32]:
    size = (2 * radius + 1,) * 2
    return np.asarray(cv2.blur(values, size, borderType=cv2.BORDER_REPLICATE))
