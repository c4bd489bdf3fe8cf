"""Pixels of known depth, few or many."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from depthcli.core.arrays import AnyArray, BoolArray, Float64Array, FloatArray, Int64Array
from depthcli.core.camera import DEPTH_M, DEPTH_M_RANGE, Anchor
from depthcli.core.options import DepthFit
from depthcli.core.types import Windows, doubt_of_metres, has_depth
from depthcli.errors import Message, UsageError
from depthcli.io.images.pixels import turn_beside, upright_places

_COLUMNS = 3
_MAX_PIXEL = 2**31
_SAME_ASPECT = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class KnownDepth:
    """Pixels of known depth."""

    x: Int64Array  #: (N,), columns from 0 at the left
    y: Int64Array  #: (N,), rows from 0 at the top
    depth_m: Float64Array  #: (N,), metres along the camera axis
    size_px: tuple[int, int] | None = None  #: (columns, rows) of their map; None for a list
    warnings: tuple[str, ...] = ()  #: about their file, or why it has none, one line each
    fit: DepthFit | None = None  #: how depth is fitted; None for the best that the model can
    may_be_outside: bool = False  #: whether most can be outside the image, as those of a lidar
    may_be_stored: bool = False  #: whether their map may be as the sensor gives it, not upright

    @classmethod
    def of(cls, points: Sequence[Anchor]) -> Self:
        """Points from a list."""
        return cls.of_table(np.array(points, np.float64).reshape(-1, _COLUMNS))

    @classmethod
    def of_table(cls, table: AnyArray) -> Self:
        """Points from (N, 3) numbers: column, row, metres; each is of the nearest pixel.

        Those without a depth or a place, such as of NaN or 0 m, are left out and counted in a
        warning, unless there are no others.
        """
        table = table.astype(np.float64)
        lowest, highest = DEPTH_M_RANGE
        is_known = np.isfinite(table).all(axis=1)
        is_known &= (table[:, 2] >= lowest) & (table[:, 2] <= highest)
        lost = np.count_nonzero(~is_known) if is_known.any() else 0
        problem = f"{lost} of {len(table)} points are behind the camera or not finite"
        warnings = (f"{problem}, and are not used",) if lost else ()
        table = table[is_known] if lost else table
        pixels = np.nan_to_num(np.rint(table[:, :2]), nan=-1)
        x, y = pixels.clip(-_MAX_PIXEL, _MAX_PIXEL).astype(np.int64).T
        return cls(x, y, table[:, 2], warnings=warnings).doubted()

    @classmethod
    def of_map(cls, depth_m: FloatArray) -> Self:
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

    def doubted(self, advice: str = "give metres") -> Self:
        """The points, with a warning if their numbers are hardly metres."""
        fact = doubt_of_metres(float(np.median(self.depth_m))) if len(self) else ""
        warning = Message(f"known depth may be in another unit: {fact}", advice)
        return replace(self, warnings=(*self.warnings, warning)) if fact else self

    def sha256(self) -> str:
        """Checksum of the points, 64 hex digits."""
        digest = hashlib.sha256(repr((self.size_px, self.fit)).encode())
        for values in (self.x.astype("<i8"), self.y.astype("<i8"), self.depth_m.astype("<f8")):
            digest.update(values.tobytes())
        return digest.hexdigest()

    def within(self, width: int, height: int) -> Self:
        """Points in an image of this size, with a warning about the others.

        Points of a map of another size and the same aspect, such as the lidar map of a phone, are
        scaled to the image.
        """
        if not len(self):
            raise UsageError("there are no known points to fit the map to")
        lowest, highest = DEPTH_M_RANGE
        for at in np.flatnonzero(~((self.depth_m >= lowest) & (self.depth_m <= highest)))[:1]:
            raise UsageError(
                f"the point {self.x[at]},{self.y[at]} has a depth of {self.depth_m[at]:g} m; give "
                f"{DEPTH_M.what}"
            )
        points = self._scaled(width, height)
        inside = (points.x >= 0) & (points.x < width) & (points.y >= 0) & (points.y < height)
        outside = int(np.count_nonzero(~inside))
        if not outside:
            return points
        problem = f"{outside} of {len(self)} known points are outside the image of {width}×{height}"
        if outside == len(self) or (2 * outside > len(self) and not self.may_be_outside):
            raise UsageError(f"{problem}; give columns and rows of the upright image")
        return replace(
            points.where(inside), warnings=(*self.warnings, f"{problem} and are not used")
        )

    def beside(self, image_px: tuple[int, int], orientation: int) -> Self:
        """The points in an image of this size that its EXIF turned, as their map where it may be.

        A warning says where the size does not tell.
        """
        if not (self.may_be_stored and self.size_px) or orientation == 1:
            return self
        turn = turn_beside(self.size_px, image_px, orientation)
        warning = (
            f"EXIF turned the image (orientation {orientation}); its depth is taken as upright"
        )
        places = np.column_stack([self.x, self.y]).astype(np.float64) + 0.5
        places, size_px = upright_places(places, self.size_px, turn or 1)
        x, y = np.floor(places).astype(np.int64).T
        warnings = (*self.warnings, warning) if turn is None else self.warnings
        return replace(self, x=x, y=y, size_px=size_px, warnings=warnings, may_be_stored=False)

    def where(self, mask: BoolArray) -> Self:
        """Those for which a mask (N,) is true."""
        return replace(self, x=self.x[mask], y=self.y[mask], depth_m=self.depth_m[mask])

    def _scaled(self, width: int, height: int) -> Self:
        """Points of a map, at the pixels of an image of another size."""
        if self.size_px in (None, (width, height)):
            return self
        columns, rows = self.size_px
        if abs(columns * height / (rows * width) - 1) > _SAME_ASPECT:
            raise UsageError(
                f"the known depth is {columns}×{rows} pixels, and the image {width}×{height}, "
                "which is another aspect"
            )
        x = np.floor((self.x + 0.5) * width / columns).astype(np.int64)
        y = np.floor((self.y + 0.5) * height / rows).astype(np.int64)
        return replace(self, x=x, y=y, size_px=(width, height))


def pixels_of(points: KnownDepth, windows: Windows | None) -> tuple[Int64Array, Int64Array]:
    """Columns and rows of points of the display window, in the pixels of the file: (N,) each."""
    rows, columns = windows.display.within(windows.pixels) if windows else (slice(0), slice(0))
    return points.x + (columns.start or 0), points.y + (rows.start or 0)
