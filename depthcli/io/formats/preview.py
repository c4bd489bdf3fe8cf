"""The preview of a depth map: a colormap over inverse depth, near is warm."""

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.options import Colormap, Near
from depthcli.core.types import DepthKind, DepthMap, Float32Array, Float64Array, Frame, UInt8Array
from depthcli.io.formats import table
from depthcli.io.images.png import encode_png
from depthcli.io.media import SOFTWARE_KEY
from depthcli.io.stored.metadata import SOFTWARE

_OPENCV = {
    Colormap.INFERNO: cv2.COLORMAP_INFERNO,
    Colormap.TURBO: cv2.COLORMAP_TURBO,
    Colormap.MAGMA: cv2.COLORMAP_MAGMA,
    Colormap.VIRIDIS: cv2.COLORMAP_VIRIDIS,
}
# ColorBrewer's Spectral, 11 classes (Brewer 2003, Apache-2.0 colour specifications), blue to red.
_SPECTRAL = (
    (94, 79, 162), (50, 136, 189), (102, 194, 165), (171, 221, 164), (230, 245, 152),
    (255, 255, 191), (254, 224, 139), (253, 174, 97), (244, 109, 67), (213, 62, 79), (158, 1, 66),
)  # fmt: skip
_LEVELS = 256
_MAX_TICKS = 5
_TICK_HEIGHT = 20  # of a label, at the reference height
_MIN_ROOM = 0.6  # closer labels touch
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_REFERENCE_HEIGHT = 480  # at this height the scale is 1
_THOUSAND = 1000
_MIN_SIZE = 0.9  # smaller text loses its decimal points


def colour_table(name: Colormap, near: Near = Near.WARM) -> UInt8Array:
    """The colours of a colormap, (256, 3) RGB uint8, far first; ``black`` turns it round."""
    levels = np.arange(_LEVELS, dtype=np.uint8)
    colours: npt.NDArray[np.generic]
    if name == Colormap.GRAY:
        colours = np.repeat(levels[:, None], 3, axis=1)
    elif name == Colormap.SPECTRAL:
        stops = np.linspace(0, _LEVELS - 1, len(_SPECTRAL))
        channels = np.array(_SPECTRAL).T
        colours = np.rint(np.stack([np.interp(levels, stops, c) for c in channels], 1))
    else:
        colours = cv2.applyColorMap(levels, _OPENCV[name]).reshape(-1, 3)[:, ::-1]
    table_8bit = np.asarray(colours, np.uint8)
    return table_8bit[::-1] if near == Near.BLACK else table_8bit


def with_legend(
    image: UInt8Array, colours: UInt8Array, near: float, far: float, kind: DepthKind
) -> UInt8Array:
    """The image, (H, W, 3) RGB uint8, with a bar of (256, 3) colours at its right, near on top."""
    height = image.shape[0]
    size = float(np.clip(height / _REFERENCE_HEIGHT, _MIN_SIZE, 4))
    margin, bar_width, width = (round(n * size) for n in (16, 20, 104))
    top = min(margin, height // 4)
    bar_height = max(1, height - 2 * top)
    panel = np.full((height, width, 3), 24, np.uint8)
    shades = colours[np.linspace(255, 0, bar_height).round().astype(int)]
    bar = panel[top : top + bar_height, margin : margin + bar_width]
    bar[:] = shades[: len(bar), np.newaxis]
    for share in _ticks(bar_height / (_TICK_HEIGHT * size), flat=near == far):
        y = top + round(share * (bar_height - 1))
        text = label(tick_value(1 - share, near, far, kind), kind)
        at, thick = (margin + bar_width + round(7 * size), y + round(5 * size)), max(1, round(size))
        cv2.putText(panel, text, at, _FONT, 0.45 * size, (235, 235, 235), thick, cv2.LINE_AA)
    return np.hstack([image, panel])


def _ticks(room: float, *, flat: bool) -> Float64Array:
    """Positions, 0 at the near end, of the ticks that fit if ``room`` labels do below the first."""
    if flat or room < _MIN_ROOM:
        return np.array([0.5])
    return np.linspace(0, 1, int(np.clip(1 + room, 2, _MAX_TICKS)))


def tick_value(nearness: float, near: float, far: float, kind: DepthKind) -> float:
    """The value at a position of the bar, 1 at the near end; inverse of the preview's mapping."""
    if kind is DepthKind.METRIC and near > 0:
        return 1 / (nearness / near + (1 - nearness) / far)
    return nearness * near + (1 - nearness) * far


def label(value: float, kind: DepthKind) -> str:
    """Three significant digits, or whole thousands, with the unit where there is one."""
    if abs(value) < _THOUSAND - 0.5:
        digits = f"{value:#.3g}".rstrip(".")
    else:
        digits = f"{value:.0f}" if abs(value) < 100 * _THOUSAND else f"{value:.2g}"
    return f"{digits} m" if kind is DepthKind.METRIC else digits


_NEAREST_M = 1e-6
_CLIPPED_SHARE = 0.02
_INVALID_RGB = (96, 96, 96)


class PreviewWriter(table.WriterOptions):
    """8-bit RGB PNG."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write the preview, also of flat, empty and infinite maps."""
        path.write_bytes(encode_png(self.render(depth, frame), {SOFTWARE_KEY: SOFTWARE}))
        return ()

    def render(
        self, depth: DepthMap, frame: Frame | None = None, spread: tuple[float, float] | None = None
    ) -> UInt8Array:
        """Draw (H, W', 3) RGB uint8, wider with legend or frame; ``spread`` is that of a video."""
        low, high = self.range_of(spread or percentiles(depth))
        near, far = (high, low) if depth.kind is DepthKind.INVERSE else (low, high)
        colours = colour_table(*self.palette)
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
            image = np.hstack([frame.pixels_8bit(is_filled=False), image])
        return np.ascontiguousarray(image)


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


def nearness(depth: DepthMap, near: float, far: float) -> Float32Array:
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
