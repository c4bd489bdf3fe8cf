"""Between image and network, as the card states: layout, input tensor, known depth, output, camera.

A network that was trained on one camera is right up to the ratio of focal lengths: that of the
image after resizing to that of the training, both in pixels of the network's input. Where
resizing stretches, the focal length is the geometric mean over both axes. Of a network that reacts
to a part of a change in apparent size, it is a power of the ratio, which the card states.
"""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from depthcli.core import imageops
from depthcli.core.camera import (
    DEPTH_M_RANGE,
    HFOV_DEG,
    CameraSource,
    Intrinsics,
    focal_px_of_crop,
    focal_px_of_hfov,
)
from depthcli.core.options import Upsampling
from depthcli.core.types import BoolArray, DepthKind, Float32Array, Float64Array, Frame, Int64Array
from depthcli.known.local_correction import log_correction, thinned
from depthcli.known.points import ROBUST_FROM, KnownDepth, pixels_of
from depthcli.models.card import (
    CameraSpec,
    Colour,
    Fit,
    InputSpec,
    MaskSpec,
    ModelCard,
    OutputSpec,
    Resize,
)

_PLANES = {
    Colour.VALUE: imageops.value_channel,
    Colour.LUMA: imageops.luma,
    Colour.RGB: imageops.rgb,
}
_RESIZES = {
    Resize.AREA: imageops.resize_area,
    Resize.LINEAR: imageops.resize_bilinear,
    Resize.CUBIC: imageops.resize_cubic,
    Resize.AREA_CUBIC: imageops.resize_area_or_cubic,
    Resize.LINEAR_CORNERS: imageops.resize_corners,
}
_ANTIALIASED = frozenset({Resize.LINEAR_ANTIALIAS, Resize.CUBIC_ANTIALIAS})
_LARGE_PIXELS = 4_000_000  # larger images are converted to float in bands
# Times the shorter side; longer images are padded to that. Chosen on held-out pairs, on which a
# longer input of the same area is worse: docs/accuracy.md.
_MAX_ASPECT = 2
_GRID_PX = 2  # pixels of the input for one of a smaller output
_WRONG, _LEAST_WRONG = 6.95, 0.005  # median deviations, and of log depth: doubtful from there on
_MAX_INPUT_PIXELS = 2**24  # of more, the first layers take more memory than machines have
_MAX_AREA_FACTOR = 16  # times the nominal pixel count, for an image that is one long strip


class Layout(NamedTuple):
    """Position of the image in the network's input; all in pixels of that input."""

    width: int  #: columns of the whole input
    height: int  #: rows of the whole input
    left: int  #: first column of the image
    top: int  #: first row of the image
    inner_width: int  #: columns of the image
    inner_height: int  #: rows of the image

    @property
    def is_padded(self) -> bool:
        """Whether the image fills less than the whole input."""
        return (self.inner_width, self.inner_height) != (self.width, self.height)


def input_layout(spec: InputSpec, width: float, height: float) -> Layout:
    """The layout of an image of ``width`` x ``height`` square pixels."""
    if spec.fit is Fit.STRETCH:
        return _without_padding(spec.width, spec.height)
    if spec.fit is Fit.LOWER_BOUND or spec.fit is Fit.UPPER_BOUND:
        return _bounded(spec, width, height)
    if spec.fit in _SIZES:
        sides = _SIZES[spec.fit](spec, width, height)
        return _without_padding(*(_multiple(side, spec.multiple_of) for side in sides))
    if spec.dynamic:
        return _same_area(spec, width, height)
    return _letterboxed(spec, spec.width, spec.height, width, height)


def prepare(spec: InputSpec, frame: Frame) -> tuple[Float32Array, Layout]:
    """The network's input for an image, (1, C, H, W) float32, normalized; and its layout."""
    layout = input_layout(spec, frame.width * frame.pixel_aspect, frame.height)
    planes, size = _PLANES[spec.colour], (layout.inner_width, layout.inner_height)
    if spec.resize is Resize.AREA and frame.width * frame.height > _LARGE_PIXELS:
        small = imageops.shrink_bands(frame.pixels, planes, *size)
    else:
        small = planes(frame.pixels)
        if spec.fit is Fit.LONGEST_SIDE:
            whole = _longest_side(spec, frame.width * frame.pixel_aspect, frame.height)
            small = _resized(spec, small, *whole)
        small = _resized(spec, small, *size)
    small = small.reshape(layout.inner_height, layout.inner_width, spec.colour.channels)
    if layout.is_padded:  # by repeating the edges: a dark border would be taken for a surface
        bottom = layout.height - layout.top - layout.inner_height
        right = layout.width - layout.left - layout.inner_width
        small = np.pad(small, ((layout.top, bottom), (layout.left, right), (0, 0)), mode="edge")
    normalized = (small - np.asarray(spec.mean, np.float32)) / np.asarray(spec.std, np.float32)
    batch = normalized.astype(np.float32, copy=False).transpose(2, 0, 1)[np.newaxis]
    return np.ascontiguousarray(batch), layout


def prompt_input(card: ModelCard, points: KnownDepth, frame: Frame, layout: Layout) -> Float32Array:
    """Known depth as the network takes it: (2, H, W) float32, coded as its output, and a mask.

    Of a network that needs a whole map, it is (1, H, W) metres, where none are known the nearest.
    A pixel has the mean of the logarithms of the points in it.
    """
    spec, output = card.input.known_depth, card.output
    if spec is not None:
        log_m, is_known = _on_grid_of(points, frame, _without_padding(spec.width, spec.height))
        return imageops.filled_nearest(np.exp(log_m).astype(np.float32), is_known)[np.newaxis]
    log_m, is_known = _on_grid_of(points, frame, layout)
    coded = np.where(is_known, (log_m - output.shift) / output.scale, 0)
    return np.stack([coded, is_known]).astype(np.float32)


def follow_points(
    card: ModelCard, coarse_m: Float32Array, frame: Frame, points: KnownDepth | None
) -> tuple[Float32Array, BoolArray | None]:
    """Metres, (h, w), that follow the points a network made them of, and which of these: (N,).

    Fewer than five points, or a network that needs a whole map, change nothing.
    """
    if points is None:
        return coarse_m, None
    x, y = pixels_of(points, frame.windows)
    inside = _is_inside(x, y, frame)
    some = thinned(inside)
    if len(some) < ROBUST_FROM or card.input.known_depth is not None:
        return coarse_m, inside
    x, y, known_m = x[some], y[some], points.depth_m[some]
    log_m = np.log(coarse_m.clip(*DEPTH_M_RANGE))
    row, column = (y + 0.5) / frame.height, (x + 0.5) / frame.width
    mapped = imageops.sample_bilinear(log_m, row, column)
    away = np.log(known_m) - mapped
    away = np.abs(away - np.median(away))
    followed = away <= max(_WRONG * float(np.median(away)), _LEAST_WRONG)
    log_m += log_correction(log_m, np.stack([row, column, mapped]), known_m, followed, passes=1)
    inside[some] = followed
    return np.exp(log_m), inside


def _is_inside(x: Int64Array, y: Int64Array, frame: Frame) -> BoolArray:
    return (x >= 0) & (x < frame.width) & (y >= 0) & (y < frame.height)


def _on_grid_of(points: KnownDepth, frame: Frame, layout: Layout) -> tuple[Float64Array, BoolArray]:
    """Mean logarithm of the points in each pixel of a layout, (H, W), and where there are any."""
    x, y = pixels_of(points, frame.windows)
    inside = _is_inside(x, y, frame)
    x, y, depth_m = x[inside], y[inside], points.depth_m[inside]
    columns = layout.left + ((x + 0.5) * layout.inner_width / frame.width).astype(np.int64)
    rows = layout.top + ((y + 0.5) * layout.inner_height / frame.height).astype(np.int64)
    cells, size = rows * layout.width + columns, layout.width * layout.height
    count = np.bincount(cells, minlength=size)
    mean = np.bincount(cells, np.log(depth_m), size) / np.maximum(count, 1)
    shape = layout.height, layout.width
    return mean.reshape(shape), count.reshape(shape) > 0


def _resized(spec: InputSpec, values: Float32Array, width: int, height: int) -> Float32Array:
    if spec.resize in _ANTIALIASED:
        is_cubic = spec.resize is Resize.CUBIC_ANTIALIAS
        return imageops.resize_antialiased(
            values, width, height, cubic=is_cubic, eight_bit=spec.eight_bit
        )
    resize = _RESIZES[spec.resize]
    if not spec.eight_bit:
        return resize(values, width, height)
    levels: Any = np.rint(values * 255).astype(np.uint8)  # OpenCV rounds weights of these, too
    return np.asarray(resize(levels, width, height) / np.float32(255), np.float32)


def _same_area(spec: InputSpec, width: float, height: float) -> Layout:
    """The pixel count of the nominal size, so that latency does not depend on the aspect."""
    nominal = spec.width / spec.height
    longest = max(_MAX_ASPECT, nominal, 1 / nominal)
    aspect = width / height / spec.pixel_aspect
    target = min(max(aspect, 1 / longest), longest)
    area = spec.width * spec.height
    sides = math.sqrt(area * target), math.sqrt(area / target)
    columns, rows = (_multiple(side, spec.multiple_of) for side in sides)
    if target == aspect:
        return _without_padding(columns, rows)
    padded = _letterboxed(spec, columns, rows, width, height)
    return _on_grid(padded) if columns % _GRID_PX == rows % _GRID_PX == 0 else padded


def _letterboxed(spec: InputSpec, columns: int, rows: int, width: float, height: float) -> Layout:
    """As large as possible in an input of ``columns`` x ``rows``, centred."""
    # The scales of rows and columns differ by the network's pixel aspect.
    scale = min(columns / width, rows / (height * spec.pixel_aspect))
    inner_width = min(columns, max(1, round(width * scale)))
    inner_height = min(rows, max(1, round(height * scale * spec.pixel_aspect)))
    left, top = (columns - inner_width) // 2, (rows - inner_height) // 2
    return Layout(columns, rows, left, top, inner_width, inner_height)


def _on_grid(padded: Layout) -> Layout:
    """The layout whose image begins and ends with a pixel of an output of half the size."""
    size, inner = padded[:2], [_multiple(side, _GRID_PX) for side in padded[4:]]
    corner = [(a - b) // 2 // _GRID_PX * _GRID_PX for a, b in zip(size, inner, strict=True)]
    return Layout(*size, *corner, *inner)


def _bounded(spec: InputSpec, width: float, height: float) -> Layout:
    """Exactly the sizes that MiDaS and Depth Anything choose.

    Source: ``Resize.get_size`` in ``util/transform.py`` of
    https://github.com/DepthAnything/Depth-Anything-V2.
    """
    lower = spec.fit is Fit.LOWER_BOUND
    scale = (max if lower else min)(spec.height / height, spec.width / width)
    most = min(_MAX_AREA_FACTOR * spec.width * spec.height, _MAX_INPUT_PIXELS)
    if lower and scale**2 * width * height > most:  # 100 GB for 1 x 5000 pixels
        scale = math.sqrt(most / (width * height))
        sides = (_multiple(scale * side, spec.multiple_of) for side in (width, height))
        return _without_padding(*sides)

    def bound(side: float, end: int) -> int:
        """The nearest multiple that is not beyond the end."""
        step = spec.multiple_of
        nearest = _multiple(side, step)
        if lower:
            return nearest if nearest >= end else math.ceil(side / step) * step
        return nearest if nearest <= end else max(step, math.floor(side / step) * step)

    return _without_padding(bound(scale * width, spec.width), bound(scale * height, spec.height))


def _minimal(spec: InputSpec, width: float, height: float) -> tuple[float, float]:
    """The sides of an image that is scaled to one of the nominal ones, as little as possible.

    Source: ``Resize.get_size`` with "minimal" of https://github.com/isl-org/MiDaS.
    """
    across, down = spec.width / width, spec.height / height
    scale = across if abs(1 - across) < abs(1 - down) else down
    return scale * width, scale * height


def _longest_side(spec: InputSpec, width: float, height: float) -> tuple[int, int]:
    """The sides of an image whose longest is the nominal width, in whole pixels.

    Source: ``InputProcessor`` of https://github.com/ByteDance-Seed/Depth-Anything-3.
    """
    scale = spec.width / max(width, height)
    return max(1, round(scale * width)), max(1, round(scale * height))


def _longest_side_multiples(spec: InputSpec, width: float, height: float) -> tuple[float, float]:
    """These sides, each to the nearest multiple, a tie to the larger one."""
    step = spec.multiple_of
    across, down = (
        (side + step // 2) // step * step for side in _longest_side(spec, width, height)
    )
    return across, down


def _own_size(spec: InputSpec, width: float, height: float) -> tuple[float, float]:
    """The sides of an image without the rest of its last multiple."""
    scale, step = min(1.0, math.sqrt(_MAX_INPUT_PIXELS / (width * height))), spec.multiple_of
    return scale * width // step * step, scale * height // step * step


_SIZES = {Fit.MINIMAL: _minimal, Fit.LONGEST_SIDE: _longest_side_multiples, Fit.OWN_SIZE: _own_size}


def _without_padding(width: int, height: int) -> Layout:
    return Layout(width, height, 0, 0, width, height)


def _multiple(size: float, step: int) -> int:
    return max(step, round(size / step) * step)


def coarse_depth(spec: OutputSpec, raw: Float32Array, layout: Layout) -> Float32Array:
    """Depth of one image from the network's raw output (h, w), (h, w) float32 of the card's kind.

    Infinities are replaced, because resizing would turn them into NaN.
    """
    depth = spec.codec.decode(raw)
    if np.isinf(depth).any():
        is_metric = spec.kind is DepthKind.METRIC
        missing = np.float32(np.nan)
        depth = in_range(spec, depth) if is_metric else np.where(np.isinf(depth), missing, depth)
    return _crop(depth, layout)


def full_size(
    spec: OutputSpec, coarse: Float32Array, frame: Frame, upsampling: Upsampling, radius: int = 1
) -> Float32Array:
    """Depth at the image's size, (H, W) float32; metres within the card's range, NaN at 0 m.

    ``coarse`` is (h, w) float32 of the whole image, ``radius`` that of the guided filter in it.
    """
    in_log = blends_in_log(spec)
    if upsampling is Upsampling.GUIDED:
        coarse = in_range(spec, coarse)
        depth = imageops.upsample_guided(coarse, frame, in_log=in_log, radius=radius)
    else:
        depth = imageops.resize_bilinear(coarse, frame.width, frame.height)
    depth = in_range(spec, depth)
    if spec.kind is DepthKind.METRIC and not in_log:
        depth[depth == 0] = np.nan
    return depth


def enlarged(spec: OutputSpec, raw: Float32Array, layout: Layout, frame: Frame) -> Float32Array:
    """Depth at the image's size, (H, W) float32, by the authors' enlarging of raw output."""
    full = _RESIZES[spec.enlarging](_crop(raw, layout), frame.width, frame.height)
    return in_range(spec, spec.codec.decode(full))


def without_depth(spec: MaskSpec, mask: Float32Array, layout: Layout, frame: Frame) -> BoolArray:
    """Pixels of an image, (H, W), to which the network's mask (h, w) gives no depth."""
    full = imageops.resize_bilinear(_crop(mask, layout), frame.width, frame.height)
    return lacks_depth(spec, full)


def lacks_depth(spec: MaskSpec, mask: Float32Array) -> BoolArray:
    """Pixels without depth of a mask of any size."""
    return mask <= spec.threshold if spec.depth_is == "above" else mask >= spec.threshold


def blends_in_log(spec: OutputSpec) -> bool:
    """Whether depth of this kind is always above 0, so that its logarithm can be blended."""
    return spec.kind is DepthKind.METRIC and bool(np.float32(spec.min_m or 0) > 0)


def in_range(spec: OutputSpec, depth: Float32Array) -> Float32Array:
    """Clip metres to the card's range, in place; other kinds have none."""
    if spec.kind is not DepthKind.METRIC:
        return depth
    # In place, because a copy of a large image's depth takes much memory.
    return np.clip(depth, np.float32(spec.min_m), np.float32(spec.max_m), out=depth)


def _crop(depth: Float32Array, layout: Layout) -> Float32Array:
    """Crop the image from a letterbox, if it is in one.

    A smaller output in which the image does not begin and end with a pixel is first resized to
    the input's size.
    """
    if not layout.is_padded:
        return depth
    stride = max(1, layout.width // depth.shape[1])
    is_smaller = depth.shape == (layout.height // stride, layout.width // stride)
    if not is_smaller or any(length % stride for length in layout):
        depth, stride = imageops.resize_bilinear(depth, layout.width, layout.height), 1
    top, left = layout.top // stride, layout.left // stride
    rows = slice(top, top + layout.inner_height // stride)
    columns = slice(left, left + layout.inner_width // stride)
    return np.ascontiguousarray(depth[rows, columns])


def metric_camera(card: ModelCard) -> CameraSpec | None:
    """The camera that a model's metres are for; None if it is not known, or the kind not metric."""
    return card.camera if card.output.kind is DepthKind.METRIC else None


def focal_warnings(card: ModelCard, camera: Intrinsics) -> tuple[str, ...]:
    """A warning if a given focal length does not scale the model's depth; else none."""
    if not camera.has_focal or metric_camera(card) is not None:
        return ()
    no_camera = f"model {card.name!r} gives no metres of a known camera"
    return (f"{no_camera}: the focal length is used for point clouds, and does not scale depth",)


def intrinsics_of(card: ModelCard, frame: Frame, camera: Intrinsics) -> Intrinsics:
    """The camera of an image, in its pixels.

    Its focal length is the given one, else that of the image's EXIF, else that of the camera that
    the model learned; None if none is known.
    """
    aspect = frame.pixel_aspect if camera.pixel_aspect is None else camera.pixel_aspect
    width, height = frame.display_size_px
    camera = replace(camera, pixel_aspect=aspect)
    focal_px, source = camera.focal_for(width, height), CameraSource.OPTION
    if focal_px is None and frame.focal_35mm is not None:
        exif = Intrinsics(pixel_aspect=aspect, focal_35mm=frame.focal_35mm)
        focal_px, source = exif.focal_for(width, height), CameraSource.EXIF
    learned = metric_camera(card)
    if focal_px is None and learned is not None:
        # docs/accuracy.md has measurements of alternatives to the largest crop.
        spec = card.input
        own_size = spec.width, spec.height / spec.pixel_aspect
        own_px = learned.focal_px_at(spec.width)
        focal_px = focal_px_of_crop(own_px, own_size, (width * aspect, height)) / aspect
        source = CameraSource.CARD
    return Intrinsics(
        focal_px,
        centre_px=camera.centre_for(width, height),
        pixel_aspect=aspect,
        source=None if focal_px is None else source,
        scale=camera.scale,
    )


def with_own_view(camera: Intrinsics, hfov_deg: float | None, width: int) -> Intrinsics:
    """A camera of an image with the network's own field of view, if its own is not known.

    Estimates out of the range of fields of view are not used.
    """
    is_known = camera.source not in {None, CameraSource.CARD}
    if is_known or hfov_deg is None or not HFOV_DEG.holds(hfov_deg):
        return camera
    return replace(camera, focal_px=focal_px_of_hfov(hfov_deg, width), source=CameraSource.MODEL)


def metric_scale(card: ModelCard, frame: Frame, layout: Layout, camera: Intrinsics) -> float:
    """The factor from the network's metres to those of an image's camera; 1 for other depth.

    The frame has the pixel aspect of its camera, which is that of :func:`intrinsics_of`.
    """
    learned = metric_camera(card)
    if learned is None or camera.focal_px is None:
        return 1.0
    across = layout.width / frame.width
    down = layout.height / frame.height * frame.pixel_aspect
    factor = math.sqrt(across * down)
    if layout.is_padded:
        # One axis is filled. On the other, rounding to whole pixels matters for a narrow strip.
        root = math.sqrt(card.input.pixel_aspect)
        factor = min(across * root, down / root)
    if learned.along == "width":
        factor = across * math.sqrt(card.input.pixel_aspect)
    elif learned.along == "mean":
        factor = (across + down) / 2
    learned_px = learned.focal_px_at(card.input.width)
    ratio = camera.focal_px * factor / (learned_px * math.sqrt(card.input.pixel_aspect))
    return float(ratio**learned.exponent)
