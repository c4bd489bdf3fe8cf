"""From a picture to the tensor that the network takes, as its card says."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from depthcli.core import colour
from depthcli.core.bands import shrink_bands
from depthcli.core.resize import resize_area, resize_bilinear, resize_cubic
from depthcli.core.types import Frame
from depthcli.models.card_specs import MAX_INPUT_PIXELS, Colour, Fit, InputSpec, Resize

_PLANES = {Colour.VALUE: colour.value_channel, Colour.LUMA: colour.luma, Colour.RGB: colour.rgb}
_RESIZES = {Resize.AREA: resize_area, Resize.LINEAR: resize_bilinear, Resize.CUBIC: resize_cubic}
_LARGE_PIXELS = 4_000_000  # whose planes of floats are no longer held at once
# Times the shorter side; longer pictures are padded to that. Chosen on held-out pairs, on which a
# longer input of the same area is worse: docs/cameras.md.
_LONGEST = 2
_MOST_PIXELS = 16  # times the nominal pixel count, for a picture that is one long strip


class Layout(NamedTuple):
    """Where the picture lies in the network's input; all in pixels of that input."""

    width: int  #: columns of the whole input
    height: int  #: rows of the whole input
    left: int  #: first column of the picture
    top: int  #: first row of the picture
    inner_width: int  #: columns of the picture
    inner_height: int  #: rows of the picture

    @property
    def is_padded(self) -> bool:
        """Whether the picture fills less than the whole input."""
        return (self.inner_width, self.inner_height) != (self.width, self.height)


def layout(spec: InputSpec, width: int, height: int) -> Layout:
    """Where a picture of ``width`` x ``height`` pixels goes."""
    if spec.fit is Fit.STRETCH:
        return _without_padding(spec.width, spec.height)
    if spec.fit is Fit.LOWER_BOUND or spec.fit is Fit.UPPER_BOUND:
        return _bounded(spec, width, height)
    if spec.dynamic:
        return _same_area(spec, width, height)
    return _inside(spec, spec.width, spec.height, width, height)


def prepare(spec: InputSpec, frame: Frame) -> tuple[npt.NDArray[np.float32], Layout]:
    """The network's input for one picture, and where the picture lies in it.

    It is (1, C, H, W) float32, normalised.
    """
    place = layout(spec, frame.width, frame.height)
    small = _resized_planes(spec, frame, place)
    small = small.reshape(place.inner_height, place.inner_width, spec.colour.channels)
    if place.is_padded:
        small = _pad(small, place)
    normalised = (small - np.asarray(spec.mean, np.float32)) / np.asarray(spec.std, np.float32)
    batch = normalised.astype(np.float32, copy=False).transpose(2, 0, 1)[np.newaxis]
    return np.ascontiguousarray(batch), place


def _resized_planes(spec: InputSpec, frame: Frame, place: Layout) -> npt.NDArray[np.float32]:
    planes = _PLANES[spec.colour]
    size = place.inner_width, place.inner_height
    if spec.resize is Resize.AREA and frame.width * frame.height > _LARGE_PIXELS:
        return shrink_bands(frame.pixels, planes, *size)
    return _RESIZES[spec.resize](planes(frame.pixels), *size)


def _same_area(spec: InputSpec, width: int, height: int) -> Layout:
    """The same pixel count as the nominal size, so the cost does not depend on the aspect."""
    nominal = spec.width / spec.height
    longest = max(_LONGEST, nominal, 1 / nominal)
    aspect = width / height / spec.pixel_aspect
    wanted = min(max(aspect, 1 / longest), longest)
    area = spec.width * spec.height
    sides = math.sqrt(area * wanted), math.sqrt(area / wanted)
    columns, rows = (_multiple(side, spec.multiple_of) for side in sides)
    if wanted == aspect:
        return _without_padding(columns, rows)
    return _inside(spec, columns, rows, width, height)


def _inside(spec: InputSpec, columns: int, rows: int, width: int, height: int) -> Layout:
    """As large as it fits into an input of ``columns`` x ``rows``, in its middle."""
    # Rows are denser than columns by the aspect of the network's pixels.
    scale = min(columns / width, rows / (height * spec.pixel_aspect))
    inner_width = min(columns, max(1, round(width * scale)))
    inner_height = min(rows, max(1, round(height * scale * spec.pixel_aspect)))
    left, top = (columns - inner_width) // 2, (rows - inner_height) // 2
    return Layout(columns, rows, left, top, inner_width, inner_height)


def _bounded(spec: InputSpec, width: int, height: int) -> Layout:
    """Sizes as MiDaS and Depth Anything choose them, to the last rounding.

    Source: ``Resize.get_size`` in ``util/transform.py`` of
    https://github.com/DepthAnything/Depth-Anything-V2.
    """
    lower = spec.fit is Fit.LOWER_BOUND
    scale = (max if lower else min)(spec.height / height, spec.width / width)
    most = min(_MOST_PIXELS * spec.width * spec.height, MAX_INPUT_PIXELS)
    if lower and scale**2 * width * height > most:
        return _layout_of_strip(spec, width, height, most)
    bound = _at_least if lower else _at_most
    return _without_padding(
        bound(scale * width, spec.multiple_of, spec.width),
        bound(scale * height, spec.multiple_of, spec.height),
    )


def _layout_of_strip(spec: InputSpec, width: int, height: int, most: int) -> Layout:
    """A picture so long that its lower bound would not fit into memory: 100 GB for 1 x 5000."""
    scale = math.sqrt(most / (width * height))
    short = _multiple(scale * min(width, height), spec.multiple_of)
    longest = max(spec.multiple_of, most // short // spec.multiple_of * spec.multiple_of)
    long = min(_multiple(scale * max(width, height), spec.multiple_of), longest)
    return _without_padding(long, short) if width > height else _without_padding(short, long)


def _at_least(size: float, step: int, least: int) -> int:
    nearest = _multiple(size, step)
    return nearest if nearest >= least else math.ceil(size / step) * step


def _at_most(size: float, step: int, most: int) -> int:
    nearest = _multiple(size, step)
    return nearest if nearest <= most else max(step, math.floor(size / step) * step)


def _without_padding(width: int, height: int) -> Layout:
    return Layout(width, height, 0, 0, width, height)


def _multiple(size: float, step: int) -> int:
    return max(step, round(size / step) * step)


def _pad(picture: npt.NDArray[np.float32], place: Layout) -> npt.NDArray[np.float32]:
    """Repeat the edges: an invented dark border would look like a surface."""
    bottom = place.height - place.top - place.inner_height
    right = place.width - place.left - place.inner_width
    return np.pad(picture, ((place.top, bottom), (place.left, right), (0, 0)), mode="edge")
