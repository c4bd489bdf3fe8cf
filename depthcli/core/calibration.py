"""A calibrated camera."""

from dataclasses import dataclass

from depthcli.core import scaling
from depthcli.errors import InputError


@dataclass(frozen=True, slots=True)
class Calibration:
    """A calibrated camera: a pinhole camera at one size of its pictures."""

    width: int  #: columns of the pictures it was calibrated with
    height: int  #: rows of these
    focal_px: float  #: focal length in pixels of these, in widths of them
    #: (cx, cy), principal point in pixels of these; (0, 0) is the middle of the first pixel
    centre_px: tuple[float, float]
    is_distorted: bool = False  #: whether its lens has a distortion, which a pinhole has not
    pixel_aspect: float = 1.0  #: width of a pixel by its height

    @property
    def hfov_deg(self) -> float:
        """Horizontal field of view in degrees, which resized pictures share."""
        return scaling.hfov_deg(self.focal_px, self.width)

    @property
    def warnings(self) -> tuple[str, ...]:
        """How it differs from a pinhole camera, one line each."""
        distorted = (
            "the camera has lens distortion, which is not removed; rectify the pictures, and then "
            "add --rectified"
        )
        return (distorted,) if self.is_distorted else ()

    def centre_for(self, width: int, height: int) -> tuple[float, float]:
        """The principal point in pixels of a picture, which may be resized.

        Raises:
            InputError: the picture has another aspect ratio, so it is cropped or turned.
        """
        # One side may be rounded to whole pixels.
        if abs(width * self.height - height * self.width) >= max(self.width, self.height):
            raise InputError(
                f"the calibration is for {self.width}×{self.height} pixels, and the picture of "
                f"{width}×{height} has another aspect ratio; give its own focal length and "
                "principal point"
            )
        scale = width / self.width
        x, y = ((centre + 0.5) * scale - 0.5 for centre in self.centre_px)
        return x, y
