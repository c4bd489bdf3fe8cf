"""The central types: a picture (input) and a depth map (output)."""

from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from depthcli.core.camera import Anchor, CameraSource
from depthcli.core.pixel_aspect import PIXEL_ASPECTS
from depthcli.core.pixels import check_pixels
from depthcli.core.windows import Windows
from depthcli.errors import InputError

if TYPE_CHECKING:  # pictures need not wait for it
    from fractions import Fraction


class DepthKind(StrEnum):
    """The meaning of a depth map's values."""

    METRIC = "metric"
    """Metres along the camera axis."""
    RELATIVE = "relative"
    """Depth up to an unknown scale and shift; larger is farther."""
    INVERSE = "inverse"
    """Inverse depth up to an unknown scale and shift; larger is nearer."""


def has_depth(
    values: npt.NDArray[np.floating], kind: DepthKind = DepthKind.METRIC
) -> npt.NDArray[np.bool_]:
    """Where there is a depth: where values are finite, and metres above 0; of any shape."""
    finite: npt.NDArray[np.bool_] = np.isfinite(values)
    return finite & (values > 0) if kind is DepthKind.METRIC else finite


# Compared by identity: == of two arrays gives an array.
@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One decoded picture, upright.

    Attributes:
        pixels: (H, W) gray or (H, W, 3) RGB; uint8, uint16, or float32 in [0, 1]. EXIF rotation is
            already applied and alpha is dropped.
        path: where it came from; None for stdin or an array.
        index: its number in the source, 0 for a still picture.
        timestamp_s: its time in a video, in seconds; None for a still picture.
        orientation: the EXIF orientation (1-8) that was undone on reading.
        focal_35mm: EXIF 35-mm-equivalent focal length in millimetres, if the file states one.
        rate: frames a second of the video that is made of it, or that an EXR states; None for
            other still pictures.
        warnings: about its file, one line each.
        pixel_aspect: width by height of a pixel, which is 1 if it is square; the network sees the
            picture with square pixels.
        windows: which part of the image plane the pixels cover, of an EXR; None if they are all of
            the frame.
        time_code: SMPTE time code of an EXR or a video's frame: hours, minutes, seconds, frame (0
            to 29; above 30 frames a second, of a pair of frames), six flags (drop frame, colour
            frame, second of the pair, three of binary groups) and eight binary groups; None if it
            has none.
    """

    pixels: npt.NDArray[np.uint8] | npt.NDArray[np.uint16] | npt.NDArray[np.float32]
    path: Path | None = None
    index: int = 0
    timestamp_s: float | None = None
    orientation: int = 1
    focal_35mm: float | None = None
    rate: "Fraction | None" = None
    warnings: tuple[str, ...] = ()
    pixel_aspect: float = 1.0
    windows: Windows | None = None
    time_code: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        """Check the pixels and their shape.

        Raises:
            InputError: another shape or type, or floats that are not in [0, 1]; or a pixel aspect
                that is not from 1e-6 to 1e6.
        """
        check_pixels(self.pixels)
        low, high = PIXEL_ASPECTS
        if not low <= self.pixel_aspect <= high:
            raise InputError(
                f"a pixel aspect of {self.pixel_aspect:g} is not from {low:g} to {high:g}"
            )

    def with_pixel_aspect(self, pixel_aspect: float) -> "Frame":
        """The frame with pixels of another shape."""
        if pixel_aspect == self.pixel_aspect:
            return self
        return replace(self, pixel_aspect=pixel_aspect)

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

    def pixels_8bit(self) -> npt.NDArray[np.uint8]:
        """The picture for display: (H, W, 3) RGB uint8, which may be the pixels themselves."""
        scaled: npt.NDArray[Any] = self.pixels
        if scaled.dtype != np.uint8:
            top = 65535 if scaled.dtype == np.uint16 else 1
            scaled = np.rint(np.clip(scaled * np.float32(255 / top), 0, 255)).astype(np.uint8)
        return scaled if scaled.ndim == 3 else np.repeat(scaled[..., None], 3, 2)  # noqa: PLR2004


class AnchorFit(NamedTuple):
    """How well metres fit known points."""

    used: int  #: points that the metres were fitted to; the others contradict them
    given: int  #: all points
    residual_m: float  #: median absolute difference of all points, in metres


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a depth map came from; written into its files, but never needed to decode them.

    In a map that was read from a file, what the file does not state is None.

    Attributes:
        model: name of the model, as in its card.
        model_sha256: checksum of the ONNX file, 64 hex digits.
        input_size_px: (width, height) of the network's input tensor.
        focal_px: focal length in pixels that the metres are for; None if neither the picture's nor
            the model's is known.
        orientation: the EXIF orientation (1-8) of the picture that was undone on reading it.
        anchors: the known points that metres were fitted to; empty if they were not, or if the
            points are from a map.
        camera_source: where ``focal_px`` comes from.
        centre_px: (cx, cy), the principal point in pixels of the map, where (0, 0) is the middle
            of the first pixel; None for the middle of the map.
        time_s: time in its video, in seconds from the first frame; None for a still picture.
        anchor_fit: how well the metres fit known points; None if they were not fitted.
        pixel_aspect: width by height of a pixel; ``focal_px`` is in widths of pixels.
    """

    model: str | None = None
    model_sha256: str | None = None
    input_size_px: tuple[int, int] | None = None
    focal_px: float | None = None
    orientation: int | None = None
    anchors: tuple[Anchor, ...] = ()
    camera_source: CameraSource | None = None
    centre_px: tuple[float, float] | None = None
    time_s: float | None = None
    anchor_fit: AnchorFit | None = None
    pixel_aspect: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class DepthMap:
    """Depth of every pixel of one picture.

    Attributes:
        values: (H, W) float32. Metres for ``DepthKind.METRIC``. NaN where there is no depth; of a
            file of another program, also infinity, and for metres 0 and below.
        kind: what the numbers mean.
        provenance: the model behind them, if any.
    """

    values: npt.NDArray[np.float32]
    kind: DepthKind = DepthKind.METRIC
    provenance: Provenance | None = None

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
    def valid(self) -> npt.NDArray[np.bool_]:
        """(H, W) bool: where there is a finite depth, for metres above 0."""
        return has_depth(self.values, self.kind)

    def __array__(
        self, dtype: npt.DTypeLike | None = None, copy: bool | None = None
    ) -> npt.NDArray[Any]:
        """The values; NumPy calls this, so a map can be used wherever an array can."""
        return np.array(self.values, dtype, copy=copy)

    def __repr__(self) -> str:
        known = self.values[self.valid]
        unit = " m" if self.is_metric else ""
        spread = f"{known.min():.3g} to {known.max():.3g}{unit}" if known.size else "no depth"
        model = f", {self.provenance.model}" if self.provenance and self.provenance.model else ""
        return f"<{type(self).__name__} {self.width}×{self.height}, {self.kind}, {spread}{model}>"
