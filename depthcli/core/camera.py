"""Options about camera and scene; free of numpy, so that they are checked before it loads."""

from dataclasses import dataclass, replace
from typing import NamedTuple, Self

from depthcli.core.calibration import Calibration
from depthcli.core.picture_options import NO_OPTIONS, PictureOptions


class Anchor(NamedTuple):
    """A pixel and its depth.

    Attributes:
        x: column, from 0 at the left.
        y: row, from 0 at the top.
        depth_m: in metres along the camera axis.
    """

    x: int
    y: int
    depth_m: float


class Lens(NamedTuple):
    """The camera of one picture: its focal length in one of two forms, and its principal point.

    Attributes:
        focal_px: focal length in pixels of the picture; None if it is not given.
        hfov_deg: horizontal field of view in degrees, instead; None if it is not given.
        centre_px: (cx, cy), principal point in pixels of the picture; None if it is not given.
    """

    focal_px: float | None = None
    hfov_deg: float | None = None
    centre_px: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Camera:
    """The given properties of the camera and the scene."""

    focal_px: float | None = None  #: focal length in pixels of the picture; None if it is not given
    #: horizontal field of view in degrees, instead of ``focal_px``; None if it is not given
    hfov_deg: float | None = None
    anchors: tuple[Anchor, ...] = ()  #: points of known depth
    pictures: PictureOptions = NO_OPTIONS  #: how its pictures are read
    #: the calibration that ``hfov_deg`` is from; None if it is from none
    calibration: Calibration | None = None
    #: (cx, cy), principal point in pixels of the picture; None if it is not given
    centre_px: tuple[float, float] | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the calibration, one line each."""
        return () if self.calibration is None else self.calibration.warnings

    @property
    def lens(self) -> Lens:
        """The focal length as it is given, and the principal point."""
        return Lens(self.focal_px, self.hfov_deg, self.centre_px)

    def centre_for(self, width: int, height: int) -> tuple[float, float] | None:
        """The principal point in pixels of a picture; None if it is not given.

        Raises:
            InputError: the calibration is for another aspect ratio.
        """
        if self.calibration is None:
            return self.centre_px
        return self.calibration.centre_for(width, height)

    def pixel_aspect_of(self, stated: float) -> float:
        """Width by height of a pixel: that of the calibration, else what the picture states."""
        return stated if self.calibration is None else self.calibration.pixel_aspect

    def with_lens(self, lens: Lens | None) -> Self:
        """The same camera with what is known of one picture's."""
        if lens is None:
            return self
        centre_px = lens.centre_px or self.centre_px
        return replace(self, focal_px=lens.focal_px, hfov_deg=lens.hfov_deg, centre_px=centre_px)
