"""Options about camera and scene; free of numpy, so that they are checked before it loads."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, Self

from depthcli.core.validation import Rule

if TYPE_CHECKING:
    from depthcli.core.calibration import Calibration

HFOV_DEG = Rule("an angle from 0.1 to 179.9 degrees", lambda deg: 0.1 <= deg <= 179.9)  # noqa: PLR2004
"""Horizontal fields of view; outside this range, depths would be almost zero or infinite."""
FOCAL_PX = Rule("a number from 0.001 to 1e8", lambda px: 1e-3 <= px <= 1e8)  # noqa: PLR2004
"""Focal lengths in pixels: what these angles give at any width of a picture."""
DEPTH_M_RANGE = 1e-3, 1e6
"""Least and largest depth of known points in metres."""
DEPTH_M = Rule(
    "a depth from 0.001 to 1000000", lambda depth_m: DEPTH_M_RANGE[0] <= depth_m <= DEPTH_M_RANGE[1]
)
"""Depths of known points in metres."""
WHITE_LEVEL = Rule("a whole number from 1 to 65535", lambda level: 1 <= level <= 0xFFFF)  # noqa: PLR2004
"""Values of white in 16-bit pictures."""


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
    """The focal length of one picture, in one of two forms.

    Attributes:
        focal_px: in pixels of the picture; None if it is not given.
        hfov_deg: horizontal field of view in degrees, instead; None if it is not given.
    """

    focal_px: float | None = None
    hfov_deg: float | None = None


@dataclass(frozen=True, slots=True)
class Camera:
    """The given properties of the camera and the scene."""

    focal_px: float | None = None  #: focal length in pixels of the picture; None if it is not given
    #: horizontal field of view in degrees, instead of ``focal_px``; None if it is not given
    hfov_deg: float | None = None
    anchors: tuple[Anchor, ...] = ()  #: points of known depth
    #: value of white in its 16-bit pictures; None for 65535, or what the file states
    white_level: int | None = None
    #: the calibration that ``hfov_deg`` is from; None if it is from none
    calibration: Calibration | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the calibration, one line each."""
        if self.calibration is None or not self.calibration.is_distorted:
            return ()
        return ("the camera has lens distortion, which is not removed; rectify the pictures first",)

    def centre_px(self, width: int, height: int) -> tuple[float, float] | None:
        """The calibrated principal point in pixels of a picture; None without a calibration.

        Raises:
            InputError: the calibration is for another aspect ratio.
        """
        return None if self.calibration is None else self.calibration.centre_for(width, height)

    @property
    def lens(self) -> Lens:
        """The given focal length, if there is one."""
        return Lens(self.focal_px, self.hfov_deg)

    def with_lens(self, lens: Lens | None) -> Self:
        """The same camera with the focal length of one picture, if it is known."""
        if lens is None:
            return self
        return replace(self, focal_px=lens.focal_px, hfov_deg=lens.hfov_deg)
