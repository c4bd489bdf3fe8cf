"""What is drawn of a depth map: a preview, a stereo pair, and a page to look around in.

A preview is a colormap over inverse depth, near is warm. A pair is for headsets, 3-D screens or
red-cyan glasses. A page is one file that needs no network.
"""

import base64
import html
import json
import math
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.options import Colormap, Near, StereoLayout
from depthcli.core.surface import Surface
from depthcli.core.types import (
    DepthKind,
    DepthMap,
    Float32Array,
    Float64Array,
    FloatArray,
    Frame,
    Int64Array,
    UInt8Array,
)
from depthcli.errors import Message, OutputError
from depthcli.io.formats import geometry, table
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


_SHARE = 0.03  # of the width: disparity between near and far, where there are no metres
_EDGE_SHARE = 1 / 128  # of the width: as wide is a smeared edge of depth
_LEAST_EDGE_PX = 2.0  # of disparity
_STEPS_OF_NEARNESS = 2**15


class StereoWriter(table.WriterOptions):
    """8-bit RGB PNG of the two views."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write the pair."""
        path.write_bytes(encode_png(self.render(depth, frame), {SOFTWARE_KEY: SOFTWARE}))
        if depth.is_metric:
            return geometry.camera_of(depth)[1]
        text = f"{depth.kind} depth has no metres: near and far are {_SHARE:.0%} of the width apart"
        return (Message(text, "predict with {anchors} for {convergence_m} in metres"),)

    def render(
        self, depth: DepthMap, frame: Frame | None = None, spread: tuple[float, float] | None = None
    ) -> UInt8Array:
        """Draw (H, 2 W, 3) or (2 H, W, 3) RGB uint8, or (H, W, 3) of half views and an anaglyph.

        ``spread`` is that of a video.
        """
        if frame is None:
            raise OutputError("a stereo pair is made of the image", "give it with {image}")
        if depth.provenance.projection.is_other:
            raise OutputError("a panorama gives no stereo pair of flat images")
        disparity_px = _sharpened(self._disparity_px(depth, spread or percentiles(depth)))
        low, high = float(disparity_px.min()), float(disparity_px.max())
        near = (disparity_px - np.float32(low)) / np.float32(max(high - low, 1e-6))
        rgb = np.ascontiguousarray(frame.pixels_8bit(is_filled=False))
        left, right = (_eye_view(rgb, disparity_px * np.float32(s), near) for s in (0.5, -0.5))
        if self.stereo_layout is StereoLayout.ANAGLYPH:
            return np.dstack([left[..., :1], right[..., 1:]])
        pair = np.concatenate([left, right], axis=int("top" not in self.stereo_layout))
        if not self.stereo_layout.startswith("half"):
            return pair
        size = depth.width, depth.height
        return np.asarray(cv2.resize(pair, size, interpolation=cv2.INTER_AREA), np.uint8)

    def _disparity_px(self, depth: DepthMap, spread: tuple[float, float]) -> Float32Array:
        """How much farther right the left eye sees a pixel than the right eye; (H, W) float32."""
        if not depth.is_metric:
            near, far = spread if depth.kind == "relative" else spread[::-1]
            share = np.nan_to_num(nearness(depth, near, far)) - np.float32(1)
            largest = _SHARE * depth.width * self.eye_distance_m / table.EYE_DISTANCE_M
            return np.asarray(share * np.float32(largest), np.float32)
        focal_px, _ = geometry.camera_of(depth)
        screen_m = self.convergence_m or spread[0]
        farthest_m = depth.values[depth.valid].max(initial=screen_m)
        values_m = np.where(depth.valid, depth.values, farthest_m)
        disparity_px = focal_px * self.eye_distance_m * (1 / values_m - 1 / screen_m)
        # Nothing is moved farther than across the image.
        return np.clip(disparity_px, -depth.width, depth.width).astype(np.float32)


def _eye_view(rgb: UInt8Array, shift_px: Float32Array, nearness: Float32Array) -> UInt8Array:
    """The image, pixels moved right by (H, W) float32; gaps show the mirrored surface behind."""
    height, width = shift_px.shape
    columns, rows = np.arange(width), np.arange(height)[:, np.newaxis]
    target = np.rint(columns + shift_px).astype(np.int64)
    inside = (target >= 0) & (target < width)
    # The nearest source of each target: its nearness and its column in one number.
    keys = np.rint(nearness * _STEPS_OF_NEARNESS).astype(np.int64) * width + columns
    best = np.full(height * width, -1, np.int64)
    np.maximum.at(best, (rows * width + target)[inside], keys[inside])
    best = best.reshape(height, width)
    source = best % width
    # Between pixels, as the target of a source is no whole column.
    place = source + columns - (source + np.take_along_axis(shift_px, source, 1))
    _fill_gaps(place, best)
    maps = place.astype(np.float32), np.broadcast_to(rows, place.shape).astype(np.float32)
    return np.asarray(
        cv2.remap(rgb, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


def _sharpened(disparity_px: Float32Array) -> Float32Array:
    """Disparity without ramps at edges, which would be drawn out: each pixel is near or far."""
    size = 2 * max(1, round(disparity_px.shape[1] * _EDGE_SHARE)) + 1
    window = np.ones((size, size), np.uint8)
    low, high = cv2.erode(disparity_px, window), cv2.dilate(disparity_px, window)
    nearest = np.where(disparity_px - low < high - disparity_px, low, high)
    return np.where(high - low > _LEAST_EDGE_PX, nearest, disparity_px).astype(np.float32)


def _fill_gaps(place: FloatArray, best: Int64Array) -> None:
    """Put columns of the surface behind where ``best``, larger where nearer, is -1."""
    width = best.shape[1]
    columns = np.arange(width)
    left = np.maximum.accumulate(np.where(best < 0, -1, columns), axis=1)
    right = np.minimum.accumulate(np.where(best < 0, width, columns)[:, ::-1], axis=1)[:, ::-1]
    row, column = np.nonzero(best < 0)
    ends = left[row, column], right[row, column]
    inside = [np.clip(end, 0, width - 1) for end in ends]
    nearness = [
        np.where(end == at, best[row, at], np.iinfo(np.int64).max)
        for end, at in zip(ends, inside, strict=True)
    ]
    end = np.where(nearness[0] <= nearness[1], *inside)
    mirrored = place[row, end] - (column - end)
    place[row, column] = np.clip(mirrored, 0, width - 1)


_HERE = Path(__file__).parent
_STEPS = 2**16 - 2
_JPEG_QUALITY = 90
_MAX_POINTS = 640 * 480  # of a page, if no stride is given


class HtmlWriter(geometry.SurfaceWriter):
    """Points or a mesh to orbit, with a grid in metres, depth at the pointer, and distances."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write the page; without the image, in the colours of a preview."""
        page, warnings = self.render(depth, frame)
        path.write_text(page, "utf-8")
        return warnings

    def render(self, depth: DepthMap, frame: Frame | None = None) -> tuple[str, tuple[str, ...]]:
        """The text of the page, and warnings; a large map is thinned if no stride is given."""
        stride = self.stride or math.ceil(math.sqrt(depth.values.size / _MAX_POINTS))
        surface, warnings = replace(self, stride=stride).surface(depth)
        pixels = PreviewWriter().render(depth) if frame is None else frame.pixels_8bit()
        bgr = np.ascontiguousarray(pixels[::stride, ::stride, ::-1])
        jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
        data = _data(depth, surface, stride) | {"image": _text(jpeg.tobytes())}
        name = frame.path.name if frame and frame.path else "Depth"
        parts = {
            "software": SOFTWARE,
            "title": html.escape(name.encode("utf-8", "replace").decode()),  # of any bytes
            "three": _module("three.module.min.js"),
            "orbit": _module("OrbitControls.js"),
            "script": (_HERE / "page.js").read_text("utf-8"),
            "data": json.dumps(data),
        }
        page = (_HERE / "page.html").read_text("utf-8")
        for part, text in parts.items():
            page = page.replace(f"@{part}@", text)
        return page, warnings


def _data(depth: DepthMap, surface: Surface, stride: int) -> dict[str, Any]:
    """Points and camera for the script: log depth in 16 bits, 0 where there is none."""
    focal_px, _ = geometry.camera_of(depth)
    source = depth.provenance
    height, width = surface.depth_m.shape
    nearest_m, farthest_m = (float(end(surface.depth_m)) for end in (np.nanmin, np.nanmax))
    log_step = max(math.log(farthest_m / nearest_m), 1e-6) / (_STEPS - 1)
    steps = np.rint(np.log(surface.depth_m / nearest_m) / log_step) + 1
    links = np.zeros((height, width), np.uint8)
    links[:, :-1] += surface.right
    links[:-1] += 2 * surface.down.astype(np.uint8)
    # High bytes, then low ones, of the differences to the row above; a third of the size.
    changes = np.diff(np.nan_to_num(steps).astype(np.uint16), axis=0, prepend=np.uint16(0))
    planes = (changes >> 8).astype(np.uint8), changes.astype(np.uint8), links
    grid = b"".join(plane.tobytes() for plane in planes)
    error = None
    if depth.error is not None:
        percent = np.rint(np.nan_to_num(depth.error[::stride, ::stride]) * 100).clip(1, 255)
        error = _text(zlib.compress(percent.astype(np.uint8).tobytes(), 9))
    return {
        "width": width,
        "height": height,
        "stride": stride,
        "size_px": (depth.width, depth.height),
        "focal_px": (focal_px, focal_px * source.pixel_aspect),
        "centre_px": source.centre_px or ((depth.width - 1) / 2, (depth.height - 1) / 2),
        "is_panorama": source.projection.is_other,
        "nearest_m": nearest_m,
        "log_step": log_step,
        "grid": _text(zlib.compress(grid, 9)),
        "error": error,
    }


def _module(name: str) -> str:
    """A script as the address of a module, so that pages opened from a file can import it."""
    return f"data:text/javascript;base64,{_text((_HERE / 'three' / name).read_bytes())}"


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
