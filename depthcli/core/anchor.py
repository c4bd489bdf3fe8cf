"""A point of a picture whose depth is known."""

from __future__ import annotations

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
