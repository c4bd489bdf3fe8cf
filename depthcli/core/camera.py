"""Options about camera and scene; free of numpy, so that they are checked before it loads."""

from dataclasses import dataclass, replace
from typing import NamedTuple, Self

from depthcli.core.validation import Rule

HFOV_DEG = Rule("an angle from 0.1 to 179.9 degrees", lambda deg: 0.1 <= deg <= 179.9)  # noqa: PLR2004
"""Horizontal fields of view; outside this range, depths would be almost zero or infinite."""
FOCAL_PX = Rule("a number from 0.001 to 1e8", lambda px: 1e-3 <= px <= 1e8)  # noqa: PLR2004
"""Focal lengths in pixels: what these angles give at any width of a picture."""
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

    @property
    def lens(self) -> Lens:
        """The given focal length, if there is one."""
        return Lens(self.focal_px, self.hfov_deg)

    def with_lens(self, lens: Lens | None) -> Self:
        """The same camera with the focal length of one picture, if it is known."""
        if lens is None:
            return self
        return replace(self, focal_px=lens.focal_px, hfov_deg=lens.hfov_deg)
