"""Pixels of known depth, few or many."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from depthcli.core.camera import DEPTH_M, DEPTH_M_RANGE, Anchor
from depthcli.core.types import has_depth
from depthcli.errors import UsageError

_COLUMNS = 3
_MAX_PIXEL = 2**31


@dataclass(frozen=True, slots=True, eq=False)
class AnchorPoints:
    """Pixels of known depth.

    Attributes:
        x: (N,) int64, columns from 0 at the left.
        y: (N,) int64, rows from 0 at the top.
        depth_m: (N,) float64, metres along the camera axis.
        size_px: (columns, rows) of the map that they are from; None for a list of points.
        warnings: about their file, one line each.
    """

    x: npt.NDArray[np.int64]
    y: npt.NDArray[np.int64]
    depth_m: npt.NDArray[np.float64]
    size_px: tuple[int, int] | None = None
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(cls, points: Sequence[Anchor]) -> Self:
        """Points from a list.

        Raises:
            UsageError: a column or row is larger than in any picture.
        """
        columns = [[point[i] for point in points] for i in range(_COLUMNS)]
        if any(abs(pixel) >= _MAX_PIXEL for pixel in (*columns[0], *columns[1])):
            raise UsageError("the column or row of an anchor is too large; give pixels from 0")
        x, y = (np.array(column, np.int64) for column in columns[:2])
        return cls(x, y, np.array(columns[2], np.float64))

    @classmethod
    def of_table(cls, table: npt.NDArray[Any]) -> Self:
        """Points from (N, 3) numbers: column, row, metres; each is of the nearest pixel.

        Raises:
            UsageError: a column or row is not finite.
        """
        pixels = np.rint(table[:, :2].astype(np.float64))
        if not (np.abs(pixels) < _MAX_PIXEL).all():
            raise UsageError("the column or row of an anchor is not finite; give pixels from 0")
        x, y = pixels.astype(np.int64).T
        return cls(x, y, table[:, 2].astype(np.float64))

    @classmethod
    def of_map(cls, depth_m: npt.NDArray[np.floating]) -> Self:
        """The pixels of a sparse map, (H, W) metres, that have a depth: finite and above 0."""
        y, x = np.nonzero(has_depth(depth_m))
        height, width = depth_m.shape
        return cls(x, y, depth_m[y, x].astype(np.float64), (width, height))

    def __len__(self) -> int:
        return len(self.depth_m)

    def listed(self) -> tuple[Anchor, ...]:
        """The points of a list; none if they are from a map."""
        if self.size_px is not None:
            return ()
        points = zip(self.x.tolist(), self.y.tolist(), self.depth_m.tolist(), strict=True)
        return tuple(Anchor(*point) for point in points)

    def sha256(self) -> str:
        """Checksum of the points, 64 hex digits."""
        digest = hashlib.sha256(repr(self.size_px).encode())
        for values in (self.x.astype("<i8"), self.y.astype("<i8"), self.depth_m.astype("<f8")):
            digest.update(values.tobytes())
        return digest.hexdigest()

    def check(self, width: int, height: int) -> None:
        """Check that they are depths in a picture of this size.

        Raises:
            UsageError: there are none, the picture has another size, or a point is outside, or its
                depth not 0.001 to 1e6 m.
        """
        if self.size_px is not None and self.size_px != (width, height):
            raise UsageError(
                f"the known depth is {self.size_px[0]}×{self.size_px[1]} pixels, but the picture "
                f"is {width}×{height}; give a map of the picture's size"
            )
        if not len(self):
            raise UsageError("there are no anchors to fit the map to; give one or more")
        lowest, highest = DEPTH_M_RANGE
        for at in np.flatnonzero(~((self.depth_m >= lowest) & (self.depth_m <= highest)))[:1]:
            raise UsageError(
                f"anchor {self.x[at]},{self.y[at]} has a depth of {self.depth_m[at]:g} m; give "
                f"{DEPTH_M.what}"
            )
        inside = (self.x >= 0) & (self.x < width) & (self.y >= 0) & (self.y < height)
        for at in np.flatnonzero(~inside)[:1]:
            raise UsageError(
                f"anchor {self.x[at]},{self.y[at]} is outside the picture of {width}×{height}"
            )
