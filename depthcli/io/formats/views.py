"""Views in space of a depth map by its camera: a stereo pair, and a page to look around in.

A pair is for headsets, 3-D screens or red-cyan glasses. A page is one file that needs no network.
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

from depthcli.core.options import StereoLayout
from depthcli.core.surface import Surface
from depthcli.core.types import DepthMap, Float32Array, FloatArray, Frame, Int64Array, UInt8Array
from depthcli.errors import Message, OutputError
from depthcli.io.formats import geometry, table
from depthcli.io.formats.preview import PreviewWriter, nearness, percentiles
from depthcli.io.images.png import encode_png
from depthcli.io.media import SOFTWARE_KEY
from depthcli.io.stored.metadata import SOFTWARE

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
