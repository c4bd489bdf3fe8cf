"""What is known of the camera and the scene; free of numpy, so that options can be read first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


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


@dataclass(frozen=True, slots=True)
class Camera:
    """What is known of the camera and the scene.

    Attributes:
        focal_px: focal length in pixels of the picture; None if it is not given.
        hfov_deg: horizontal field of view in degrees, in its place; None likewise.
        anchors: points of known depth.
    """

    focal_px: float | None = None
    hfov_deg: float | None = None
    anchors: tuple[Anchor, ...] = ()
