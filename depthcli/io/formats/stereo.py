"""A stereo pair from an image and its depth, for headsets, 3-D screens or red-cyan glasses."""

from pathlib import Path

import cv2
import numpy as np

from depthcli.core.arrays import Float32Array, FloatArray, Int64Array, UInt8Array
from depthcli.core.options import StereoLayout
from depthcli.core.types import DepthMap, Frame
from depthcli.errors import Message, OutputError
from depthcli.io.formats.geometry import camera_of
from depthcli.io.formats.options import EYE_DISTANCE_M, WriterOptions
from depthcli.io.formats.preview import nearness, percentiles
from depthcli.io.images.png import encode_png
from depthcli.io.marks import SOFTWARE_KEY
from depthcli.io.stored.metadata import SOFTWARE

_SHARE = 0.03  # of the width: disparity between near and far, where there are no metres
_EDGE_SHARE = 1 / 128  # of the width: as wide is a smeared edge of depth
_LEAST_EDGE_PX = 2.0  # of disparity
_LEVELS = 2**15


class StereoWriter(WriterOptions):
    """8-bit RGB PNG of the two views."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write the pair."""
        path.write_bytes(encode_png(self.render(depth, frame), {SOFTWARE_KEY: SOFTWARE}))
        if depth.is_metric:
            return camera_of(depth)[1]
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
            largest = _SHARE * depth.width * self.eye_distance_m / EYE_DISTANCE_M
            return np.asarray(share * np.float32(largest), np.float32)
        focal_px, _ = camera_of(depth)
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
    keys = np.rint(nearness * _LEVELS).astype(np.int64) * width + columns
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
