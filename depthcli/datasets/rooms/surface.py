"""Intersections of rays and solids: points, normals, and texture coordinates."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from depthcli.datasets.rooms.patterns import Floats
from depthcli.datasets.rooms.solids import Hits, Solids

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
    cuts = np.einsum("nkj,nj->nk", solids.cuts[solid], q)
    values = np.concatenate([np.abs(q), quadric[:, None], cuts], 1)
    active = values.argmax(1)  # the bound on which a point lies has the value 1
    axis = np.minimum(active, 2)
    every = np.arange(len(q))
    normal = np.zeros_like(q)
    normal[every, axis] = np.sign(q[every, axis])
    curved = active == 3
    normal[curved] = (solids.quadric[solid] * q)[curved]
    cut = np.flatnonzero(active > 3)
    normal[cut] = solids.cuts[solid[cut], active[cut] - 4]
    axis[curved | (active > 3)] = np.abs(normal[curved | (active > 3)]).argmax(1)
    world = np.einsum("nij,ni->jn", matrix, normal)
    world /= np.linalg.norm(world, axis=0)
    local = q * solids.half[solid]
    across = local[every, np.where(axis == 0, 2, 0)]
    along = local[every, np.where(axis == 1, 2, 1)]
    return world, np.stack([across, along])
