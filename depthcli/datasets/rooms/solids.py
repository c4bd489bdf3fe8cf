"""Convex solids, and ray casting.

A solid is a box in its own frame, or its intersection with a quadric: a cylinder or an ellipsoid.
Directions: x right, y up, z ahead, in metres.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from depthcli.datasets.rooms.materials import Floats, Material

Vector = tuple[float, float, float]

_CHUNK_RAYS = 1 << 14  # rays whose working arrays stay in a core's cache
_MAX_GROUP_PARTS = 16  # parts with a common bounding box
_TINY = np.float32(1e-20)  # in place of 0, whose product with its infinite inverse is NaN
_NO_QUADRIC: Vector = (0.0, 0.0, 0.0)
CYLINDER_Y: Vector = (1.0, 0.0, 1.0)
"""Quadric of an upright cylinder: x² + z² ≤ 1 in its own frame."""
CYLINDER_X: Vector = (0.0, 1.0, 1.0)
CYLINDER_Z: Vector = (1.0, 1.0, 0.0)
SPHERE: Vector = (1.0, 1.0, 1.0)


class Part(NamedTuple):
    """One solid of a piece of furniture; q is from -1 to 1 along each of its own axes."""

    centre: Vector  #: its middle, metres
    half: Vector  #: half of its size along its own axes, metres
    material: Material  #: what it is made of
    quadric: Vector = _NO_QUADRIC  #: weights w of the quadric Σ w q² ≤ 1; zeros for none
    axes: npt.NDArray[np.float64] = np.eye(3)  #: its own axes as rows, orthonormal

    def moved(self, at: Vector, yaw_deg: float = 0.0) -> Self:
        """Rotated about the vertical axis through the origin, then translated."""
        turn = rotation(yaw_deg, 1)
        x, y, z = turn @ np.array(self.centre) + at
        return self._replace(centre=(x, y, z), axes=self.axes @ turn.T)

    def tilted(self, deg: float, axis: int) -> Self:
        """Rotated about its own centre."""
        return self._replace(axes=self.axes @ rotation(deg, axis).T)


def box(x: Sequence[float], y: Sequence[float], z: Sequence[float], material: Material) -> Part:
    """A box between two values of each coordinate."""
    low, high = np.array([x, y, z], float).T
    centre, half = (low + high) / 2, (high - low) / 2
    return Part(tuple(centre), tuple(half), material)


def centred_box(half: float, y: Sequence[float], z: Sequence[float], material: Material) -> Part:
    """A box that is centred on x = 0."""
    return box((-half, half), y, z, material)


def rotation(deg: float, axis: int) -> npt.NDArray[np.float64]:
    """Rotation matrix (3, 3) about one of the axes x, y, z."""
    cos, sin = np.cos(np.radians(deg)), np.sin(np.radians(deg))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[a, a], matrix[a, b], matrix[b, a], matrix[b, b] = cos, -sin, sin, cos
    return matrix


class Hits(NamedTuple):
    """The first hits of rays."""

    distance: Floats  #: (N,) in lengths of the ray; ``reach`` where nothing is hit
    solid: npt.NDArray[np.int32]  #: (N,) index; -1 where nothing is hit


class Solids:
    """Parts in groups with bounding boxes, for ray casting.

    Attributes:
        parts: all parts, in the order of their index.
        matrix: (S, 3, 3) from metres in the room to the frame in which a solid is from -1 to 1.
        offset: (S, 3) added after it.
    """

    def __init__(self, groups: Sequence[Sequence[Part]]) -> None:
        self.parts = [part for group in groups for part in group]
        half = np.array([part.half for part in self.parts])
        axes = np.array([part.axes for part in self.parts])
        centre = np.array([part.centre for part in self.parts])
        matrix = axes / half[:, :, None]
        self.matrix = matrix.astype(np.float32)
        self.offset = -np.einsum("sij,sj->si", matrix, centre).astype(np.float32)
        self.half = half.astype(np.float32)
        self.quadric = np.array([part.quadric for part in self.parts], np.float32)
        reach = np.einsum("sij,si->sj", np.abs(axes), half)
        # Consecutive parts are near each other: a row of books, the legs of a table.
        lengths = [
            min(_MAX_GROUP_PARTS, len(g) - i)
            for g in groups
            for i in range(0, len(g), _MAX_GROUP_PARTS)
        ]
        starts = np.cumsum([0, *lengths])
        self._members = [slice(a, b) for a, b in pairwise(starts.tolist())]
        self._low = np.minimum.reduceat(centre - reach, starts[:-1]).astype(np.float32)
        self._high = np.maximum.reduceat(centre + reach, starts[:-1]).astype(np.float32)

    def cast(self, origin: Floats, rays: Floats, reach: float = np.inf) -> Hits:
        """The first solid that each ray enters; a solid that contains the origin is not hit.

        Args:
            origin: (3, N) or (3, 1) metres.
            rays: (3, N) directions of any length.
            reach: distance at which a ray ends, in its lengths.
        """
        count = rays.shape[1]
        hits = Hits(np.full(count, reach, np.float32), np.full(count, -1, np.int32))
        rays = np.where(rays == 0, _TINY, rays)
        with np.errstate(divide="ignore", invalid="ignore"):
            for first in range(0, count, _CHUNK_RAYS):
                some = slice(first, first + _CHUNK_RAYS)
                part = origin if origin.shape[1] == 1 else origin[:, some]
                self._cast(part, rays[:, some], Hits(hits[0][some], hits[1][some]))
        return hits

    def _cast(self, origin: Floats, rays: Floats, hits: Hits) -> None:
        inverse = 1 / rays
        for group, members in enumerate(self._members):
            a = (self._low[group][:, None] - origin) * inverse
            b = (self._high[group][:, None] - origin) * inverse
            enter, leave = _max_of_rows(np.minimum(a, b)), _min_of_rows(np.maximum(a, b))
            near = np.flatnonzero((leave >= np.maximum(enter, 0)) & (enter < hits.distance))
            if near.size:
                start = _take_columns(origin, near)
                distance, solid = self._nearest(members, start, rays.take(near, 1))
                closer = distance < hits.distance[near]
                hits.distance[near[closer]] = distance[closer]
                hits.solid[near[closer]] = solid[closer]

    def _nearest(self, members: slice, origin: Floats, rays: Floats) -> Hits:
        matrix = self.matrix[members].reshape(-1, 3)
        start = _matmul(matrix, origin) + self.offset[members].reshape(-1, 1)
        start = start.reshape(-1, 3, origin.shape[1])
        step = _matmul(matrix, rays).reshape(-1, 3, rays.shape[1])
        inverse = 1 / step
        behind = start * inverse
        np.abs(inverse, out=inverse)
        enter = -_min_of_rows(np.moveaxis(behind + inverse, 1, 0))
        leave = -_max_of_rows(np.moveaxis(behind - inverse, 1, 0))
        for i, solid in enumerate(range(members.start, members.stop)):
            if self.parts[solid].quadric != _NO_QUADRIC:
                some = np.flatnonzero(enter[i] < leave[i])
                interval = self._interval(
                    solid, _take_columns(start[i], some), step[i].take(some, 1)
                )
                enter[i, some] = np.maximum(enter[i, some], interval[0])
                leave[i, some] = np.minimum(leave[i, some], interval[1])
        enter[~((enter < leave) & (enter > 0))] = np.inf
        distance = enter.min(0)
        best = (enter == distance).argmax(0)  # argmin over so few rows takes twice as long
        return Hits(distance, (best + members.start).astype(np.int32))

    def _interval(self, solid: int, start: Floats, step: Floats) -> tuple[Floats, Floats]:
        """Intervals of rays (3, N) in the solid's frame that are inside its quadric."""
        weight = self.quadric[solid][:, None]
        a = (weight * step * step).sum(0)
        b = (weight * start * step).sum(0)
        c = (weight * start * start).sum(0) - 1
        root = np.sqrt(np.where(a > 0, b * b - a * c, -c))  # NaN, which compares false: missed
        along = a == 0
        enter = np.where(along, np.where(c > 0, np.inf, -np.inf), (-b - root) / a)
        leave = np.where(along, np.inf, (-b + root) / a)
        return enter.astype(np.float32), leave.astype(np.float32)


def _take_columns(vectors: Floats, index: npt.NDArray[np.int64]) -> Floats:
    """Columns of vectors (3, N); (3, 1) is returned unchanged, for broadcasting."""
    return vectors if vectors.shape[1] == 1 else vectors.take(index, 1)


def _max_of_rows(rows: Floats) -> Floats:
    """The maximum of three rows, several times as fast as a reduction."""
    largest: Floats = np.maximum(np.maximum(rows[0], rows[1]), rows[2])
    return largest


def _min_of_rows(rows: Floats) -> Floats:
    smallest: Floats = np.minimum(np.minimum(rows[0], rows[1]), rows[2])
    return smallest


def _matmul(matrix: Floats, vectors: Floats) -> Floats:
    """Product (P, N) without BLAS, whose threads would compete and change rounding."""
    product: Floats = np.einsum("pk,kn->pn", matrix, vectors)
    return product


RAY_OFFSET_M = 1e-3
"""Distance from a surface at which a ray starts, so that it does not hit that again."""


class SurfacePoints(NamedTuple):
    """The points that rays hit."""

    at: Floats  #: (3, N) metres
    normal: Floats  #: (3, N) outward, of length 1
    across: Floats  #: (2, N) coordinates on the surface, metres
    hits: Hits

    @property
    def face(self) -> npt.NDArray[np.int64]:
        """(N) number of the solid's face, on which light is denoised."""
        axis: npt.NDArray[np.int64] = np.abs(self.normal).argmax(0)
        return 3 * self.hits.solid + axis


def intersect(solids: Solids, origin: Floats, rays: Floats) -> SurfacePoints:
    """The first intersections of rays (3, N); where nothing is hit, only ``hits`` is valid."""
    hits = solids.cast(origin, rays)
    at = origin + rays * np.where(hits.solid >= 0, hits.distance, 0)
    return SurfacePoints(at, *_surface(solids, at, np.maximum(hits.solid, 0)), hits)


def _surface(solids: Solids, points: Floats, solid: npt.NDArray[np.int32]) -> tuple[Floats, Floats]:
    """Outward normals (3, N) and coordinates on the surface (2, N), metres, of points on it."""
    matrix = solids.matrix[solid]
    q = np.einsum("nij,jn->ni", matrix, points) + solids.offset[solid]
    quadric = np.sqrt((solids.quadric[solid] * q * q).sum(1))
    values = np.concatenate([np.abs(q), quadric[:, None]], 1)
    active = values.argmax(1)  # the bound on which a point lies has the value 1
    axis = np.minimum(active, 2)
    every = np.arange(len(q))
    normal = np.zeros_like(q)
    normal[every, axis] = np.sign(q[every, axis])
    curved = active == 3
    normal[curved] = (solids.quadric[solid] * q)[curved]
    axis[curved] = np.abs(normal[curved]).argmax(1)
    world = np.einsum("nij,ni->jn", matrix, normal)
    world /= np.linalg.norm(world, axis=0)
    local = q * solids.half[solid]
    across = local[every, np.where(axis == 0, 2, 0)]
    along = local[every, np.where(axis == 1, 2, 1)]
    return world, np.stack([across, along])
