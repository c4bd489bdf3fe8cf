"""Cameras: focal length, field of view and principal point; free of numpy, for the command line.

An object at twice the focal length looks as it does at half the distance, so a network that was
trained on one camera is right up to the ratio of focal lengths: depth ∝ focal length.
"""

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple, Self

from depthcli.core.options import Rule
from depthcli.errors import InputError, Message, UsageError

WIDEST_DEG = 130.0  #: horizontal field of view; hardly any camera without distortion sees more
HFOV_DEG = Rule("an angle from 0.1 to 179.9 degrees", lambda deg: 0.1 <= deg <= 179.9)  # noqa: PLR2004
"""Horizontal fields of view; outside this range, depths would be almost zero or infinite."""
FOCAL_PX = Rule("a number from 0.001 to 1e8", lambda px: 1e-3 <= px <= 1e8)  # noqa: PLR2004
"""Focal lengths in pixels: what these angles give at any width of an image."""
FOCAL_35MM = Rule("from 3 to 20000 mm", lambda mm: 3 <= mm <= 20_000)  # noqa: PLR2004
"""35-mm equivalents, from fisheyes to telescopes; others are mistakes."""
PIXEL_ASPECT = Rule("a number from 0.1 to 10", lambda ratio: 0.1 <= ratio <= 10)  # noqa: PLR2004
"""Widths of pixels by their heights."""
CENTRE_PX = Rule("a number from -1e6 to 1e6", lambda px: abs(px) <= 1e6)  # noqa: PLR2004
"""Principal points in pixels, in x and in y; a crop may have it outside the image."""
DEPTH_M_RANGE = 1e-3, 1e6  #: least and largest depth of known points in metres
DEPTH_M = Rule(  #: depths of known points in metres
    "a depth from 0.001 to 1000000", lambda depth_m: DEPTH_M_RANGE[0] <= depth_m <= DEPTH_M_RANGE[1]
)
FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)


class Anchor(NamedTuple):
    """A pixel and its depth."""

    x: int  #: column, from 0 at the left
    y: int  #: row, from 0 at the top
    depth_m: float  #: in metres along the camera axis


class CameraSource(StrEnum):
    """Where a focal length comes from."""

    OPTION = "option"  #: it was given
    EXIF = "exif"  #: the image's file states it
    CARD = "card"  #: assumed: that of the camera that the model was trained for
    MODEL = "model"  #: the network estimates it from the image


@dataclass(frozen=True, slots=True)
class CameraScale:
    """Correction of a model's metres that was measured for a camera: scale · depth + shift."""

    name: str  #: of the camera
    model: str  #: name of the model
    model_sha256: str  #: checksum of its ONNX file
    scale: float  #: factor on depth
    shift_m: float  #: added to depth, in metres
    #: mean of |error| ÷ depth on points that were left out of the fit; None of a single point
    residual: float | None
    images: int  #: images that it was measured on
    points: int  #: points of known depth

    def __post_init__(self) -> None:
        if not (0 < self.scale < math.inf and math.isfinite(self.shift_m)):
            raise UsageError(f"a scale of {self.scale} with a shift of {self.shift_m} m is none")


class Distortion(NamedTuple):
    """Distortion of a lens, as OpenCV models it."""

    focal_px: tuple[float, float]  #: fx and fy that it was measured with
    #: k1, k2, p1, p2, k3, …; of a fisheye lens k1 to k4; none of a model that OpenCV lacks
    coefficients: tuple[float, ...]
    is_fisheye: bool = False


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole camera, as far as it is known."""

    focal_px: float | None = None  #: focal length in widths of pixels
    #: horizontal field of view in degrees, which images of any width share; before ``focal_px``
    hfov_deg: float | None = None
    #: (cx, cy), principal point in pixels, where (0, 0) is the middle of the first; None for the
    #: middle of the image
    centre_px: tuple[float, float] | None = None
    #: (columns, rows) of the images that these pixels are of; None for the image at hand
    size_px: tuple[int, int] | None = None
    pixel_aspect: float | None = None  #: width by height of a pixel; None for what the image states
    source: CameraSource | None = None  #: where the focal length comes from, if that is known
    distortion: Distortion | None = None  #: of its lens, which a pinhole has not
    is_undistorted: bool = False  #: whether images are rectified by it when they are read
    scale: CameraScale | None = None  #: correction of metres that was measured for it
    #: 35-mm equivalent of its focal length in millimetres, as of EXIF; after the other two
    focal_35mm: float | None = None

    def __post_init__(self) -> None:
        focal_px, hfov_deg = self.focal_px, self.hfov_deg
        if focal_px is not None and not 0 < focal_px < math.inf:
            raise UsageError(f"a focal length of {focal_px} pixels is not a number above 0")
        if hfov_deg is not None and not HFOV_DEG.holds(hfov_deg):
            raise UsageError(f"a field of view of {hfov_deg}° is not {HFOV_DEG.what}")

    @classmethod
    def given(
        cls,
        focal_px: float | None,
        hfov_deg: float | None,
        centre_px: tuple[float, float] | None = None,
    ) -> Self:
        """A camera of the user, whose focal length is in one of two forms."""
        if focal_px is not None and hfov_deg is not None:
            raise UsageError("give the focal length or the field of view, not both")
        centre = None if centre_px is None else (float(centre_px[0]), float(centre_px[1]))
        return cls(focal_px, hfov_deg, centre)

    @property
    def has_focal(self) -> bool:
        """Whether the focal length is known."""
        return (self.focal_px, self.hfov_deg, self.focal_35mm) != (None, None, None)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Doubts about a calibration, one line each."""
        distorted = Message(
            "the camera has lens distortion, which is not removed",
            "predict with {undistort}, or rectify the images first and then add {rectified}",
        )
        unsized = Message(
            "the calibration states no image size, so its pixels are taken for those of the images",
            "do not resize or crop these",
        )
        is_calibrated = None not in {self.focal_px, self.pixel_aspect, self.centre_px}
        is_unsized = is_calibrated and self.size_px is None
        is_distorted = self.distortion is not None and not self.is_undistorted
        return (distorted,) * is_distorted + (unsized,) * is_unsized

    def focal_for(self, width: int, height: int) -> float | None:
        """Focal length in pixels of an image of this size; None if it is not known."""
        if self.hfov_deg is not None:
            return focal_px_of_hfov(float(self.hfov_deg), width)
        if self.focal_px is not None:
            return float(self.focal_px)
        if self.focal_35mm is None:
            return None
        # By CIPA DCG-001, the angle over the diagonal is that of a lens on a frame of 36 x 24 mm.
        aspect = self.pixel_aspect or 1
        return self.focal_35mm * math.hypot(width * aspect, height) / FILM_DIAGONAL_MM / aspect

    def centre_for(self, width: int, height: int) -> tuple[float, float] | None:
        """The principal point in pixels of an image, which may be resized; None for its middle."""
        if self.size_px is None or self.centre_px is None:
            return self.centre_px
        own_width, own_height = self.size_px
        # One side may be rounded to whole pixels.
        if abs(width * own_height - height * own_width) >= max(own_width, own_height):
            size = f"{own_width}×{own_height}"
            problem = f"the calibration is for {size} pixels, another aspect than {width}×{height}"
            advice = "give its own focal length and principal point"
            if abs(width * own_width - height * own_height) < max(own_width, own_height):
                advice = "if EXIF turned the image, turn its pixels, or calibrate upright images"
            raise InputError(problem, advice)
        scale = width / own_width
        x, y = ((centre + 0.5) * scale - 0.5 for centre in self.centre_px)
        return x, y

    def of_image(self, camera: "Intrinsics | None") -> "Intrinsics":
        """The camera of one image: its own, completed by this one; this one if it has none."""
        if camera is None:
            return self
        if camera.centre_px is None:
            camera = replace(camera, centre_px=self.centre_px, size_px=self.size_px)
        return replace(
            camera, pixel_aspect=camera.pixel_aspect or self.pixel_aspect, scale=self.scale
        )


UNKNOWN_CAMERA = Intrinsics()  #: nothing is known but what the image's file states


def focal_px_of_hfov(hfov_deg: float, width: int) -> float:
    """Focal length in pixels of an image ``width`` pixels wide, of a field of view in degrees."""
    return width / 2 / math.tan(math.radians(hfov_deg) / 2)


def focal_px_of_crop(
    focal_px: float, own_size: tuple[float, float], size: tuple[float, float]
) -> float:
    """Focal length in square pixels of the largest crop, upright or not, of a camera's images."""
    return focal_px * max(a / b for a, b in zip(sorted(size), sorted(own_size), strict=True))


def hfov_deg(focal_px: float, width: int) -> float:
    """Horizontal field of view in degrees of a focal length in pixels."""
    return math.degrees(2 * math.atan(width / 2 / focal_px))
