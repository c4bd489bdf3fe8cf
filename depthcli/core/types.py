"""The central types: arrays, an image (input), a network's codec, and a depth map (output)."""

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from depthcli.core.camera import Anchor, CameraScale, CameraSource, Intrinsics
from depthcli.core.options import DepthFit, Projection, chosen
from depthcli.errors import InputError

Float32Array: TypeAlias = npt.NDArray[np.float32]
Float64Array: TypeAlias = npt.NDArray[np.float64]
FloatArray: TypeAlias = npt.NDArray[np.floating]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
Int64Array: TypeAlias = npt.NDArray[np.int64]
UInt8Array: TypeAlias = npt.NDArray[np.uint8]
UInt16Array: TypeAlias = npt.NDArray[np.uint16]
AnyArray: TypeAlias = npt.NDArray[Any]

_GRAY_RANK, _RGB = 2, 3
# Colours out of gamut and resampling make some negatives; an image in [-1, 1] has many.
_ROUNDING, _NEGATIVE_SHARE = 0.01, 0.1
_LIT_SHARE = 0.01  # a few bright pixels on black are highlights


def is_out_of_range(pixels: Float32Array, low: float, high: float) -> bool:
    """Whether a finite image, from ``low`` to ``high``, is in another range than [0, 1].

    Highlights may be above 1, if they are less than half of what is not black.
    """
    negative = pixels.size * _NEGATIVE_SHARE
    if low < -_ROUNDING and np.count_nonzero(pixels < -_ROUNDING) > negative:
        return True
    if high <= 1 + _ROUNDING:
        return False
    lit = max(float(np.count_nonzero(pixels > 0)), pixels.size * _LIT_SHARE)
    return bool(np.count_nonzero(pixels > 1 + _ROUNDING) * 2 > lit)


class Window(NamedTuple):
    """A rectangle of pixels in the coordinates of an OpenEXR file: x to the right, y down."""

    left: int  #: its first column
    top: int  #: its first row
    right: int  #: the column after its last one
    bottom: int  #: the row after its last one

    @property
    def width(self) -> int:
        """Columns; 0 if it is empty."""
        return max(0, self.right - self.left)

    @property
    def height(self) -> int:
        """Rows; 0 if it is empty."""
        return max(0, self.bottom - self.top)

    @property
    def is_empty(self) -> bool:
        """Whether it has no pixel."""
        return not (self.width and self.height)

    def moved(self, columns: int, rows: int) -> "Window":
        """Move the rectangle."""
        left, top = self.left + columns, self.top + rows
        return Window(left, top, self.right + columns, self.bottom + rows)

    def union(self, other: "Window") -> "Window":
        """The smallest window around both."""
        corner = min(self.left, other.left), min(self.top, other.top)
        return Window(*corner, max(self.right, other.right), max(self.bottom, other.bottom))

    def intersection(self, other: "Window") -> "Window":
        """The pixels that are in both; possibly none."""
        corner = max(self.left, other.left), max(self.top, other.top)
        return Window(*corner, min(self.right, other.right), min(self.bottom, other.bottom))

    def within(self, outer: "Window") -> tuple[slice, slice]:
        """Rows and columns of this window in an array that covers an outer one."""
        top, left = self.top - outer.top, self.left - outer.left
        return slice(top, top + self.height), slice(left, left + self.width)


def over_window(values: Float32Array, covered: Window, window: Window) -> Float32Array:
    """Values of one window as those of another, with NaN outside the first; (H, W) float32."""
    if covered == window:
        return values
    result = np.full((window.height, window.width), np.nan, np.float32)
    both = covered.intersection(window)
    result[both.within(window)] = values[both.within(covered)]
    return result


@dataclass(frozen=True, slots=True)
class Windows:
    """Which part of the image plane a frame's pixels cover."""

    pixels: Window  #: what the array of pixels covers: the display window, and overscan around it
    data: Window  #: the pixels of the file, some of which may be outside ``pixels``
    display: Window  #: the part of ``pixels`` that is shown, and that the field of view is of

    @property
    def valid(self) -> Window:
        """The part of ``pixels`` that the file has; possibly none."""
        return self.data.intersection(self.pixels)

    @property
    def seen(self) -> Window:
        """The part of ``pixels`` that a network sees: all but overscan that the file lacks."""
        return self.display.union(self.valid)

    def only(self, window: Window, values: Float32Array) -> Float32Array:
        """Values, (H, W) float32 over ``pixels``, with NaN outside a window."""
        return over_window(over_window(values, self.pixels, window), window, self.pixels)


PIXEL_ASPECTS = 1e-3, 1e3  #: least and largest width of a pixel by its height


def pixel_aspect_of(ratio: Fraction | None, *, is_turned: bool) -> float:
    """Width by height of an upright pixel, of that as stored; 1 if none is, or out of range."""
    if not ratio or not PIXEL_ASPECTS[0] <= ratio <= PIXEL_ASPECTS[1]:
        return 1.0
    return float(1 / ratio if is_turned else ratio)


class DepthKind(StrEnum):
    """The meaning of a depth map's values."""

    METRIC = "metric"  #: metres along the camera axis
    RELATIVE = "relative"  #: depth up to an unknown scale and shift; larger is farther
    INVERSE = "inverse"  #: inverse depth up to an unknown scale and shift; larger is nearer


def has_depth(values: FloatArray, kind: DepthKind = DepthKind.METRIC) -> BoolArray:
    """Where there is a depth: where values are finite, and metres above 0; of any shape."""
    finite: BoolArray = np.isfinite(values)
    return finite & (values > 0) if kind is DepthKind.METRIC else finite


# Compared by identity: == of two arrays gives an array.
@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One decoded image, upright."""

    #: (H, W) gray or (H, W, 3) RGB; uint8, uint16, or float32 in [0, 1]; without alpha
    pixels: UInt8Array | UInt16Array | Float32Array
    path: Path | None = None  #: where it came from; None for stdin or an array
    index: int = 0  #: its number in the source, 0 for a still image
    timestamp_s: float | None = None  #: time in a video, in seconds; None for a still image
    orientation: int = 1  #: EXIF orientation (1-8) that was undone on reading
    #: EXIF 35-mm-equivalent focal length in millimetres, as stated or by the sensor's size
    focal_35mm: float | None = None
    focal_mm: float | None = None  #: EXIF focal length of the lens in millimetres, if it is stated
    #: frames a second of the video that is made of it, or that an EXR states
    rate: Fraction | None = None
    warnings: tuple[str, ...] = ()  #: about its file, one line each
    pixel_aspect: float = 1.0  #: width by height of a pixel; the network sees square ones
    windows: Windows | None = None  #: what the pixels of an EXR cover; None for all of the frame
    #: SMPTE time code of an EXR or a video's frame: hours, minutes, seconds, frame (0 to 29; above
    #: 30 frames a second, of a pair of frames), six flags (drop frame, colour frame, second of the
    #: pair, three of binary groups) and eight binary groups
    time_code: tuple[int, ...] | None = None
    projection: Projection = Projection.PINHOLE  #: how directions became its pixels
    #: (H, W), pixels that are not part of the image, filled with colours around them
    transparent: BoolArray | None = None
    view: str | None = None  #: eye of a stereo EXR, such as ``left``

    def __post_init__(self) -> None:
        pixels: AnyArray = self.pixels
        shape, dtype = pixels.shape, pixels.dtype
        if len(shape) < _GRAY_RANK or shape[_GRAY_RANK:] not in ((), (_RGB,)) or 0 in shape:
            problem = f"pixels of shape {shape} are not an image; give (H, W) or (H, W, 3) RGB"
            raise InputError(problem)
        if dtype not in (np.uint8, np.uint16, np.float32):
            problem = f"pixels have to be uint8, uint16 or float32, not {dtype}; convert them"
            raise InputError(problem)
        if dtype == np.float32:
            low, high = float(pixels.min()), float(pixels.max())
            is_finite = math.isfinite(low) and math.isfinite(high)
            if not is_finite or is_out_of_range(pixels, low, high):
                problem = f"float pixels have to be finite and in [0, 1], not {low:g} to {high:g}"
                raise InputError(problem, "scale them, and replace the others with np.nan_to_num")
        object.__setattr__(self, "projection", chosen(Projection, self.projection, "projection"))

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.pixels.shape[0])

    @property
    def width(self) -> int:
        """Columns."""
        return int(self.pixels.shape[1])

    @property
    def display_size_px(self) -> tuple[int, int]:
        """(columns, rows) that its field of view is of: those of its pixels without overscan."""
        if self.windows is None:
            return self.width, self.height
        return self.windows.display.width, self.windows.display.height

    def __repr__(self) -> str:
        colours = "gray" if self.pixels.ndim == 2 else "RGB"  # noqa: PLR2004
        path = f", {self.path}" if self.path else ""
        return f"<Frame {self.width}×{self.height}, {colours} {self.pixels.dtype}{path}>"

    def pixels_8bit(self, *, is_filled: bool = True) -> UInt8Array:
        """(H, W, 3) RGB uint8, maybe the pixels themselves; unless filled, black if transparent."""
        scaled: AnyArray = self.pixels
        if scaled.dtype != np.uint8:
            top = 65535 if scaled.dtype == np.uint16 else 1
            scaled = np.rint(np.clip(scaled * np.float32(255 / top), 0, 255)).astype(np.uint8)
        rgb = scaled if scaled.ndim == 3 else np.repeat(scaled[..., None], 3, 2)  # noqa: PLR2004
        if is_filled or self.transparent is None:
            return rgb
        return np.where(self.transparent[..., None], np.uint8(0), rgb)


class AnchorFit(NamedTuple):
    """Residual of the fit of metres to known points."""

    used: int  #: points that the metres were fitted to; the others contradict them
    given: int  #: all points before the camera, of a cloud one in each pixel
    residual_m: float  #: median absolute difference of those in the image, in metres
    fit: DepthFit | None = None  #: how depth follows them; None if that is not known


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a depth map came from; written into its files, but never needed to decode them.

    In a map that was read from a file, what the file does not state is None.
    """

    model: str | None = None  #: name of the model, as in its card
    model_sha256: str | None = None  #: checksum of the ONNX file, 64 hex digits
    input_size_px: tuple[int, int] | None = None  #: (width, height) of the network's input tensor
    focal_px: float | None = None  #: focal length that the metres are for, in widths of pixels
    orientation: int | None = None  #: EXIF orientation (1-8) of the image that was undone
    anchors: tuple[Anchor, ...] = ()  #: listed points that metres were fitted to; none of a map
    camera_source: CameraSource | None = None  #: where ``focal_px`` comes from
    #: (cx, cy), principal point in pixels, where (0, 0) is the middle of the first; None for the
    #: middle of the map
    centre_px: tuple[float, float] | None = None
    time_s: float | None = None  #: time in its video, in seconds from the first frame
    anchor_fit: AnchorFit | None = None  #: how well the metres fit known points, if they were
    pixel_aspect: float = 1.0  #: width by height of a pixel
    #: whether a focal length was stated for another size, of which this map is no resized one
    is_cropped: bool = False
    projection: Projection = Projection.PINHOLE  #: in a panorama, metres are along the ray
    camera_scale: CameraScale | None = None  #: measured correction that the metres have


@dataclass(frozen=True, slots=True, eq=False)
class DepthMap:
    """Depth of every pixel of one image."""

    #: (H, W) float32, metres for ``DepthKind.METRIC``; NaN where there is no depth
    values: Float32Array
    kind: DepthKind = DepthKind.METRIC  #: what the numbers mean
    provenance: Provenance = Provenance()  #: how they were made, as far as that is known
    #: (H, W) float32, expected |depth - true depth| by true depth; None if it is not estimated
    error: Float32Array | None = None

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.values.dtype != np.float32:  # noqa: PLR2004
            msg = f"depth is (H, W) float32, not {self.values.shape} {self.values.dtype}"
            raise ValueError(msg)
        object.__setattr__(self, "kind", DepthKind(self.kind))

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.values.shape[0])

    @property
    def width(self) -> int:
        """Columns."""
        return int(self.values.shape[1])

    @property
    def is_metric(self) -> bool:
        """Whether the values are metres."""
        return self.kind is DepthKind.METRIC

    @property
    def unit(self) -> str | None:
        """``m``; None for relative and inverse depth."""
        return "m" if self.is_metric else None

    @property
    def valid(self) -> BoolArray:
        """(H, W) bool: where there is a finite depth, for metres above 0."""
        return has_depth(self.values, self.kind)

    def over(self, covered: Window, window: Window) -> Self:
        """The map of one window as that of another, with NaN outside the first."""
        error = None if self.error is None else over_window(self.error, covered, window)
        return replace(self, values=over_window(self.values, covered, window), error=error)

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> AnyArray:
        return np.array(self.values, dtype, copy=copy)

    def __repr__(self) -> str:
        values = self.values[self.valid]
        unit = " m" if self.is_metric else ""
        spread = f"{values.min():.3g} to {values.max():.3g}{unit}" if values.size else "no depth"
        model = f", {self.provenance.model}" if self.provenance.model else ""
        return f"<{type(self).__name__} {self.width}×{self.height}, {self.kind}, {spread}{model}>"


def panorama_rays(width: int, height: int, rows: slice = slice(None)) -> Float32Array:
    """Unit vectors, (rows, W, 3) float32: x right, y down, z to the middle of the panorama."""
    longitude = ((np.arange(width) + 0.5) / width - 0.5) * (2 * math.pi)
    latitude = (((np.arange(height) + 0.5) / height - 0.5) * math.pi)[rows, np.newaxis]
    across = np.cos(latitude)
    rays = across * np.sin(longitude), np.sin(latitude), across * np.cos(longitude)
    return np.stack(np.broadcast_arrays(*rays), -1).astype(np.float32)


def masked_to_data_window(depth: DepthMap, windows: Windows | None) -> DepthMap:
    """Remove depth of a frame's pixels where its file has none."""
    if windows is None:
        return depth
    return replace(depth, values=windows.only(windows.valid, depth.values))


def displayed_depth(depth: DepthMap, windows: Windows | None) -> DepthMap:
    """The part of a frame's map that is in its display window."""
    return depth if windows is None else depth.over(windows.pixels, windows.display)


def displayed_frame(frame: Frame) -> Frame:
    """A frame without the pixels outside its display window."""
    return frame if frame.windows is None else _cut(frame, frame.windows, frame.windows.display)


def seen_frame(frame: Frame) -> Frame:
    """A frame cut to the pixels of its file, where other files of a sequence have more overscan."""
    return frame if frame.windows is None else _cut(frame, frame.windows, frame.windows.seen)


def _cut(frame: Frame, windows: Windows, window: Window) -> Frame:
    if windows.pixels == window:
        return frame
    pixels: Any = np.ascontiguousarray(frame.pixels[window.within(windows.pixels)])
    return replace(frame, pixels=pixels, windows=replace(windows, pixels=window))


class DepthRange(NamedTuple):
    """Least, median and largest depth, in the map's unit; None where it has no depth at all."""

    min: float | None
    median: float | None
    max: float | None

    @classmethod
    def of(cls, depth: DepthMap) -> Self:
        """The range of a depth map where it has depth."""
        values = depth.values[depth.valid]
        if not values.size:
            return cls(None, None, None)
        # As np.median, which would import numpy.ma and take as long as writing a PNG.
        middle = (values.size - 1) // 2, values.size // 2
        low, high = np.partition(values, middle)[[*middle]]
        median = float(low / 2 + high / 2)  # a sum could overflow
        return cls(float(values.min()), median, float(values.max()))


def range_facts(depth: DepthMap) -> dict[str, float | None]:
    """Its range by name, and the median of the errors that are expected, if they are known."""
    error = {} if depth.error is None else {"expected_error": float(np.nanmedian(depth.error))}
    return {**DepthRange.of(depth)._asdict(), **error}


PLAUSIBLE_M = 0.05, 100.0  #: medians of numbers that are taken for metres without a word


def doubt_of_metres(median_m: float) -> str:
    """The fact that numbers are hardly metres, but too large or too small; else empty."""
    low_m, high_m = PLAUSIBLE_M
    return "" if low_m <= median_m <= high_m else f"as metres its median is {median_m:.3g} m"


def with_camera(depth: DepthMap, camera: Intrinsics) -> DepthMap:
    """Depth that states a given camera; what of it is not given stays as it is."""
    changes: dict[str, Any] = {
        "focal_px": camera.focal_for(depth.width, depth.height),
        "centre_px": camera.centre_for(depth.width, depth.height),
        "pixel_aspect": camera.pixel_aspect,
    }
    changes = {name: value for name, value in changes.items() if value is not None}
    if "focal_px" in changes:
        changes |= {"camera_source": CameraSource.OPTION, "is_cropped": False}
    source = depth.provenance
    provenance = replace(source, **changes)
    return depth if provenance == source else replace(depth, provenance=provenance)


class Transform(StrEnum):
    """Function from ``t = scale * raw + shift`` to depth."""

    LINEAR = "linear"  #: depth = t
    EXP = "exp"  #: depth = exp(t)
    RECIPROCAL = "reciprocal"  #: depth = 1 / t


class DepthCodec(NamedTuple):
    """Depth of a raw network output."""

    transform: Transform = Transform.LINEAR  #: the shape of the mapping
    scale: float = 1.0  #: factor on the raw output
    shift: float = 0.0  #: added after the factor

    @classmethod
    def log_m(cls, min_m: float, max_m: float) -> Self:
        """Raw [-1, 1] to [min_m, max_m] metres, evenly in log depth."""
        low, high = float(np.log(min_m)), float(np.log(max_m))
        return cls(Transform.EXP, (high - low) / 2, (high + low) / 2)

    def times(self, factor: float) -> Self:
        """The mapping to depth that is multiplied by a factor greater than 0."""
        if self.transform is Transform.EXP:
            return self._replace(shift=self.shift + math.log(factor))
        if self.transform is Transform.RECIPROCAL:
            factor = 1 / factor
        return self._replace(scale=self.scale * factor, shift=self.shift * factor)

    def decode(self, raw: Float32Array) -> Float32Array:
        """Depth of a raw output; any shape, float32 in and out.

        A reciprocal of zero or less is infinitely far, hence ``inf``. NaN stays NaN.
        """
        t = raw * np.float32(self.scale) + np.float32(self.shift)
        match self.transform:
            case Transform.LINEAR:
                return t
            case Transform.EXP:
                with np.errstate(over="ignore"):
                    depth: Float32Array = np.exp(t)
                return depth
            case Transform.RECIPROCAL:
                with np.errstate(divide="ignore", over="ignore"):
                    return np.where(t <= 0, np.float32(np.inf), np.float32(1) / t)
