"""Operations on images and maps: resizing, brightness, filling, sampling, guided upsampling.

Resizing has half-pixel centres, and is the same in training, inference and evaluation.

Guided upsampling makes the edges of a coarse map follow those of an image. Around each coarse
pixel, the map is modelled as a linear function of the image's brightness. The coefficients are
upsampled, a few rows at a time, and applied to the image itself. Slopes are multiplied by a gain
first, because a network's edges are blurred.

Source: He, Sun and Tang, "Guided Image Filtering", TPAMI 2013; He and Sun, "Fast Guided Filter",
arXiv:1505.00996. The gain and the clamping to the local range are our own.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.types import BoolArray, Float32Array, Float64Array, FloatArray, Frame
from depthcli.errors import Message


def resize_bilinear(values: Float32Array, width: int, height: int) -> Float32Array:
    """Bilinear, half-pixel centres, edges repeated, no antialiasing: how depth is resized.

    From (H, W) or (H, W, C) float32 to (height, width) or (height, width, C), as all others here;
    a copy only if the size changes.
    """
    if values.shape[:2] == (height, width):
        return values
    return np.asarray(cv2.resize(values, (width, height)))


def _rows_at(values: Float32Array, place: FloatArray) -> Float32Array:
    """Rows at fractional places, interpolated; never a view."""
    above = place.astype(np.intp)
    share = (place - above).astype(np.float32).reshape(-1, *[1] * (values.ndim - 1))
    upper, mixed = values[above], values[np.minimum(above + 1, len(values) - 1)]
    mixed -= upper  # in place, as new arrays take longer than what is computed
    mixed *= share
    mixed += upper
    return mixed


def resize_area(values: Float32Array, width: int, height: int) -> Float32Array:
    """Mean over each output pixel's area where it shrinks, bilinear where it grows: images."""
    if values.shape[:2] == (height, width):
        return values
    rows, columns = values.shape[:2]
    if width <= columns and height <= rows:
        return np.asarray(cv2.resize(values, (width, height), interpolation=cv2.INTER_AREA))
    # OpenCV's area method repeats pixels where it grows, so such an axis is stretched on its own.
    shrunk = (min(width, columns), min(height, rows))
    return resize_bilinear(resize_area(values, *shrunk), width, height)


def resize_cubic(values: Float32Array, width: int, height: int) -> Float32Array:
    """Bicubic, half-pixel centres, edges repeated, no antialiasing; it may overshoot."""
    return np.asarray(cv2.resize(values, (width, height), interpolation=cv2.INTER_CUBIC))


def resize_area_or_cubic(values: Float32Array, width: int, height: int) -> Float32Array:
    """OpenCV's INTER_AREA if both sides shrink, else its INTER_CUBIC."""
    rows, columns = values.shape[:2]
    is_smaller = width <= columns and height <= rows
    return (resize_area if is_smaller else resize_cubic)(values, width, height)


def resize_corners(values: Float32Array, width: int, height: int) -> Float32Array:
    """Bilinear, in which the corner pixels keep their place: torch's ``align_corners``."""
    rows, columns = values.shape[:2]
    x = np.linspace(0, columns - 1, width, dtype=np.float32)
    y = np.linspace(0, rows - 1, height, dtype=np.float32)
    return _rows_at(_rows_at(values, y).swapaxes(0, 1), x).swapaxes(0, 1)


_ANTIALIAS_ROWS = 32
_FIXED_POINT = 2**22


def resize_antialiased(
    values: Float32Array, width: int, height: int, *, cubic: bool, eight_bit: bool = False
) -> Float32Array:
    """Bilinear or bicubic (a = -0.5) with a kernel that is as wide as an output pixel: Pillow's.

    With ``eight_bit``, colours in [0, 1] are rounded to 8 bits after each axis. Source: Pillow's
    ``Resample.c``, which torch's ``antialias=True`` follows.
    """
    for size in (width, height):
        rows = np.ascontiguousarray(np.swapaxes(values, 0, 1))
        values = _antialiased_rows(rows, size, cubic=cubic, eight_bit=eight_bit)
    return values


def _antialiased_rows(
    values: Float32Array, size: int, *, cubic: bool, eight_bit: bool
) -> Float32Array:
    rows = values.shape[0]
    if size == rows:
        return values
    step = rows / size
    wide = max(step, 1.0)
    reach = (2 if cubic else 1) * wide
    flat = np.ascontiguousarray(values).reshape(rows, -1)
    result = np.empty((size, flat.shape[1]), np.float32)
    for start in range(0, size, _ANTIALIAS_ROWS):
        centres = (np.arange(start, min(start + _ANTIALIAS_ROWS, size)) + 0.5) * step
        first = max(0, int(centres[0] - reach))
        last = min(rows, int(centres[-1] + reach) + 1)
        places = np.arange(first, last) + 0.5
        weights = _kernel(np.abs(places - centres[:, None]) / wide, cubic=cubic)
        weights /= weights.sum(axis=1, keepdims=True)
        if eight_bit:  # whole levels and fixed-point weights, as Pillow has them
            weights = np.rint(weights * _FIXED_POINT) / _FIXED_POINT
            levels = np.floor(weights @ np.rint(flat[first:last] * 255.0) + 0.5)  # halves up
            band = np.asarray(levels.clip(0, 255) / np.float32(255), np.float32)
        else:
            band = weights.astype(np.float32) @ flat[first:last]
        result[start : start + len(centres)] = band
    return result.reshape(size, *values.shape[1:])


def _kernel(distance: Float64Array, *, cubic: bool) -> Float64Array:
    """Triangle, or Keys' cubic with a = -0.5, at distances in output pixels."""
    if not cubic:
        return np.maximum(1 - distance, 0)
    inner = (1.5 * distance - 2.5) * distance**2 + 1
    outer = ((-0.5 * distance + 2.5) * distance - 4) * distance + 2
    return np.where(distance < 1, inner, np.where(distance < 2, outer, 0))  # noqa: PLR2004


#: pixels of a band: its few float arrays fit a processor's caches; with smaller ones, threads wait
#: for each other, as each of some thirty calls a band takes the GIL again
BAND_PIXELS = 160_000


def filled_nearest(values: Float32Array, valid: BoolArray) -> Float32Array:
    """Values of (H, W), where they are not valid those of the nearest valid pixel."""
    return values if valid.all() else values.ravel()[nearest_places(valid)]


def nearest_places(mask: BoolArray) -> npt.NDArray[np.intp]:
    """Flat index of the nearest pixel, for each, that is true in a mask; (H, W)."""
    _, labels = cv2.distanceTransformWithLabels(
        (~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    places = np.zeros(int(labels.max()) + 1, np.intp)
    places[labels[mask]] = np.flatnonzero(mask)
    nearest: npt.NDArray[np.intp] = places[labels]
    return nearest


def row_bands(width: int, height: int) -> Iterator[slice]:
    """Rows of an image from top to bottom, about :data:`BAND_PIXELS` pixels at a time."""
    count = -(-height // -(-height * width // BAND_PIXELS))
    for top in range(0, height, count):
        yield slice(top, min(top + count, height))


def shrink_bands(
    pixels: npt.NDArray[np.generic],
    plane: Callable[[npt.NDArray[np.generic]], Float32Array],
    width: int,
    height: int,
) -> Float32Array:
    """Equal ``resize_area(plane(pixels), width, height)`` up to rounding, band by band."""
    rows, columns = pixels.shape[:2]
    narrowest = min(width, columns)  # a strip is widened once it is short
    narrow = [
        resize_area(plane(pixels[band]), narrowest, band.stop - band.start)
        for band in row_bands(columns, rows)
    ]
    return resize_area(np.concatenate(narrow), width, height)


_LUMA = np.array([[0.299, 0.587, 0.114]], np.float32)


def value_channel(pixels: npt.NDArray[np.generic]) -> Float32Array:
    """V of HSV, the largest of R, G and B, (H, W) float32 in [0, 1]; gray is its own V.

    Pixels are (H, W) or (H, W, 3) RGB; uint8, uint16, or float32 in [0, 1].
    """
    if pixels.ndim == 2:  # noqa: PLR2004
        return unit(pixels)
    red, green, blue = cv2.split(pixels)  # type: ignore[arg-type]
    return unit(cv2.max(cv2.max(red, green), blue))


def luma(pixels: npt.NDArray[np.generic]) -> Float32Array:
    """Rec. 601 luma of the coded values; arguments and result as in :func:`value_channel`."""
    if pixels.ndim == 2:  # noqa: PLR2004
        return unit(pixels)
    gray = np.asarray(cv2.transform(unit(pixels), _LUMA), np.float32)
    return gray.reshape(pixels.shape[:2])


def brightness(pixels: npt.NDArray[np.generic]) -> Float32Array:
    """Luma to the precision of the pixels' own type, which is much faster than :func:`luma`."""
    if pixels.ndim == 2:  # noqa: PLR2004
        return unit(pixels)
    return unit(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY))  # type: ignore[arg-type]


def rgb(pixels: npt.NDArray[np.generic]) -> Float32Array:
    """Three channels (H, W, 3) float32 in [0, 1]; gray is repeated."""
    values = unit(pixels)
    return values if values.ndim == 3 else np.repeat(values[..., None], 3, axis=2)  # noqa: PLR2004


def unit(pixels: npt.NDArray[np.generic]) -> Float32Array:
    """Coded values of any shape as float32 in [0, 1]."""
    if pixels.dtype == np.float32:
        return np.clip(pixels, 0, 1)
    top = 255 if pixels.dtype == np.uint8 else 65535
    return pixels.astype(np.float32) * np.float32(1 / top)


# Chosen on held-out scenes, see docs/sharpness.md: less smoothing copies texture into depth, and
# more gain sharpens where there is no edge.
_SMOOTHING = 1e-3  # variance of brightness in [0, 1] below which the map keeps its local mean
_GAIN = 1.5
# Of log depth less its mean around a pixel, below which brightness says nothing of depth, as the
# texture of a plane; three times as much counts fully.
_LEAST_BEND = 0.003
# Of edges: a change of log depth that is complete within the window, as no slope's is. More edges
# make videos flicker.
_LEAST_STEP = 0.1
_LEAST_SHARE = 0.5  # of the change within twice the window
_RAMP = 0.3  # of shares, from where nothing is sharpened to where all is
_STEEPER = 4.0
_LEAST_SIDE_PX = 48  # the window is too large a part of smaller maps to tell edges from slopes


def upsample_guided(
    depth: Float32Array, frame: Frame, *, in_log: bool, radius: int = 1
) -> Float32Array:
    """Depth at the image's size, whose edges follow those of the image.

    It is bilinear if the image is no larger than the map, or the map has holes. The result is
    (H, W) float32, within the range of ``depth``, (h, w) float32, near each pixel. With ``in_log``,
    log depth is filtered, which treats edges alike near and far, and edges are made steeper;
    ``depth`` must be above 0 then. The radius of the window is the width of a pixel of the
    network's own output.
    """
    height, width = depth.shape
    if frame.width <= width or frame.height <= height or not np.isfinite(depth).all():
        return resize_bilinear(depth, frame.width, frame.height)
    small = shrink_bands(frame.pixels, brightness, width, height)
    sharpens = in_log and min(depth.shape) >= _LEAST_SIDE_PX
    coarse = np.log(depth) if in_log else depth
    coefficients = guided_coefficients(coarse, small, radius, sharpens=sharpens)
    values = np.empty((frame.height, frame.width), np.float32)
    for rows in row_bands(frame.width, frame.height):
        numbers = np.arange(rows.start, rows.stop)
        place = np.clip((numbers + 0.5) * (height / frame.height) - 0.5, 0, height - 1)
        slope, offset, low, high = (
            resize_bilinear(_rows_at(part, place), frame.width, len(place)) for part in coefficients
        )
        band = cv2.multiply(slope, brightness(frame.pixels[rows]), dst=slope)
        band = cv2.add(band, offset, dst=band)
        band = np.asarray(cv2.min(cv2.max(band, low, dst=band), high, dst=band))
        values[rows] = np.exp(band, out=band) if in_log else band
    return values


def sample_bilinear(values: Float32Array, row: Float64Array, column: Float64Array) -> Float64Array:
    """Values of a map (h, w) float32 at rows and columns from 0 to 1, (N,) each, N < 32,767."""
    height, width = values.shape
    x, y = (column * width - 0.5).astype(np.float32), (row * height - 0.5).astype(np.float32)
    samples: Any = cv2.remap(values, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(samples.ravel(), np.float64)


def guided_coefficients(
    coarse: Float32Array, guide: Float32Array, radius: int, *, sharpens: bool
) -> tuple[Float32Array, Float32Array, Float32Array, Float32Array]:
    """Fit ``coarse``, finite, to the image's brightness at its size; (h, w) float32 both.

    ``sharpens`` makes edges of log depth steeper, within a range of twice the radius, and leaves
    out the texture of planes.

    Returns:
        (h, w) float32 each, to be applied at any larger size: the change of the map with the
        image's brightness, the map where brightness is 0, and the least and the largest value of
        the map near each pixel, to which it is clamped.
    """
    mean: Any = partial(cv2.blur, ksize=(2 * radius + 1,) * 2, borderType=cv2.BORDER_REPLICATE)
    mean_guide, mean_coarse = mean(guide), mean(coarse)
    # Differences of large numbers lose float32's digits, so the mean is subtracted first.
    centred = np.asarray(coarse - coarse.mean(), np.float32)
    covariance = mean(guide * centred) - mean_guide * mean(centred)
    variance = mean(guide * guide) - mean_guide * mean_guide
    slope = np.asarray(_GAIN * covariance / (variance.clip(0) + _SMOOTHING), np.float32)
    if sharpens:
        _, bend = _range_within(np.abs(coarse - mean_coarse), 2 * radius)
        slope = slope * ((bend / np.float32(_LEAST_BEND) - 1) / 2).clip(0, 1)
    offset = np.asarray(mean_coarse - slope * mean_guide, np.float32)
    slope, offset = mean(slope), mean(offset)
    low, high = _range_within(coarse, 2 * radius if sharpens else radius)
    if sharpens:
        gain = _steepening(low, high, radius)
        slope, offset = slope * gain, offset * gain + (low + high) / 2 * (1 - gain)
    return slope, offset, low, high


def _range_within(values: Float32Array, radius: int) -> tuple[Float32Array, Float32Array]:
    """Least and largest value within a radius of each pixel."""
    window = np.ones((2 * radius + 1,) * 2, np.uint8)
    return np.asarray(cv2.erode(values, window)), np.asarray(cv2.dilate(values, window))


def _steepening(low: Float32Array, high: Float32Array, radius: int) -> Float32Array:
    """Factor on the distance of log depth from the middle of its range; 1 away from edges."""
    change = high - low
    wider = _range_within(high, 2 * radius)[1] - _range_within(low, 2 * radius)[0]
    share = change / np.maximum(wider, np.float32(1e-6))
    is_large = (2 * (change / np.float32(_LEAST_STEP) - 1)).clip(0, 1)
    is_complete = ((share - np.float32(_LEAST_SHARE)) / np.float32(_RAMP)).clip(0, 1)
    # The border cuts windows off, so that a slope there looks complete.
    margin = 4 * radius
    is_inside = np.zeros_like(low)
    is_inside[margin:-margin, margin:-margin] = 1
    return np.asarray(1 + np.float32(_STEEPER - 1) * is_large * is_complete * is_inside, np.float32)


_HDR_TRANSFERS = {16: "PQ", 18: "HLG"}  # of ITU-T H.273

PANORAMA = Message(  #: a warning
    "it states that it is a panorama, and is taken for an image of a pinhole camera",
    "give {projection} equirectangular if it shows all directions",
)


def transfer_warning(transfer: int, what: str, to: str) -> str | None:
    """A warning about high dynamic range, by a code of ITU-T H.273; None without it."""
    name = _HDR_TRANSFERS.get(transfer)
    if name is None:
        return None
    return (
        f"the colours are high dynamic range ({name}) and are taken as they are stored; for better "
        f"depth, convert the {what} to {to} first"
    )
