"""A preview of a depth map: a colormap over inverse depth, near is warm."""

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.types import DepthKind, DepthMap, Frame
from depthcli.io.depth.metadata import SOFTWARE
from depthcli.io.formats.drawing import colour_table, with_legend
from depthcli.io.formats.table import SOFTWARE_KEY, WriterOptions
from depthcli.io.images.png import encode_png

_NEAREST_M = 1e-6
_CLIPPED_SHARE = 0.02
_INVALID_RGB = (96, 96, 96)


class PreviewWriter(WriterOptions):
    """8-bit RGB PNG."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write the preview, also of flat, empty and infinite maps."""
        path.write_bytes(encode_png(self.render(depth, frame), {SOFTWARE_KEY: SOFTWARE}))
        return ()

    def render(
        self, depth: DepthMap, frame: Frame | None = None, spread: tuple[float, float] | None = None
    ) -> npt.NDArray[np.uint8]:
        """Draw (H, W', 3) RGB uint8, wider with legend or frame; ``spread`` is that of a video."""
        low, high = self.range_of(spread or percentiles(depth))
        near, far = (high, low) if depth.kind is DepthKind.INVERSE else (low, high)
        colours = colour_table(self.colormap, self.near)
        share = nearness(depth, near, far)
        holes = np.isnan(share)
        share[holes] = 0
        levels = np.rint(255 * share).astype(np.uint8)
        # As colours[levels], in a tenth of the time.
        image = np.asarray(cv2.applyColorMap(levels, colours[:, np.newaxis]), np.uint8)
        image[holes] = _INVALID_RGB
        if self.legend:
            image = with_legend(image, colours, near, far, depth.kind)
        if self.side_by_side and frame is not None:
            image = np.hstack([frame.pixels_8bit(), image])
        return np.ascontiguousarray(image)

    def range_of(self, spread: tuple[float, float]) -> tuple[float, float]:
        """Low and high end of the colours, where ``vmin`` and ``vmax`` replace those of a map."""
        low = spread[0] if self.vmin is None else self.vmin
        high = spread[1] if self.vmax is None else self.vmax
        # A percentile gives way to a limit that is given.
        return (min(low, high), high) if self.vmin is None else (low, max(low, high))


def percentiles(depth: DepthMap) -> tuple[float, float]:
    """The 2nd and the 98th percentile of valid depth; 1 and 1 if there is none."""
    values = depth.values[depth.valid]
    if not values.size:
        return 1.0, 1.0
    # np.percentile would load numpy.ma, at 15 ms.
    low = round(_CLIPPED_SHARE * (values.size - 1))
    high = values.size - 1 - low
    ordered = np.partition(values, (low, high))
    return float(ordered[low]), float(ordered[high])


def nearness(depth: DepthMap, near: float, far: float) -> npt.NDArray[np.float32]:
    """1 at ``near``, 0 at ``far``, NaN without depth; (H, W) float32.

    Metric maps are interpolated in inverse depth, or in depth if the near end is 0. If both ends
    are equal, values equal to them are 0.5.
    """
    values, ends = depth.values, np.array([near, far], np.float32)
    if depth.is_metric and near > 0:
        values = np.reciprocal(np.maximum(values, np.float32(_NEAREST_M)))
        ends = np.reciprocal(np.maximum(ends, np.float32(_NEAREST_M)))
    elif depth.kind is not DepthKind.INVERSE:
        values, ends = -values, -ends
    span = ends[0] - ends[1]
    with np.errstate(over="ignore"):  # of nearly equal ends
        share = np.sign(values - ends[1]) + 0.5 if span <= 0 else (values - ends[1]) / span
    return np.where(depth.valid, np.clip(share, 0, 1), np.nan).astype(np.float32)
