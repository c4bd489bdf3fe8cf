"""Rendering a room: colours and exact depth."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from depthcli.datasets.rooms.camera import PinholeCamera
from depthcli.datasets.rooms.furnish import Room
from depthcli.datasets.rooms.illumination import Illumination
from depthcli.datasets.rooms.patterns import TILE_PX, Floats, sample_pattern
from depthcli.datasets.rooms.solids import Solids
from depthcli.datasets.rooms.surface import RAY_OFFSET_M, SurfacePoints, intersect

_WHITE = 1.5  # brighter samples are clipped to this at edges, which would look jagged otherwise


class View(NamedTuple):
    """A rendered picture, before the sensors are simulated."""

    light: Floats  #: (H, W, 3) linear RGB, 1 for white under the room's usual light
    depth_m: Floats  #: (H, W) metres along the camera axis, 0 where no solid is hit
    specular: Floats  #: (H, W) share of a mirror's reflection, [0, 1]
    slant: Floats  #: (H, W) absolute cosine of the angle between ray and normal


class Renderer:
    """Renders one room for one camera.

    Args:
        room: the room.
        solids: its solids.
        camera: the camera.
        random: generator of the samples of lights.
    """

    def __init__(
        self, room: Room, solids: Solids, camera: PinholeCamera, random: np.random.Generator
    ) -> None:
        self._room, self._solids, self._camera = room, solids, camera
        self._illumination = Illumination(room, solids, (camera.width, camera.height), random)
        materials = [part.material for part in solids.parts]
        self._dark = np.array([material.dark for material in materials], np.float32).T
        self._light = np.array([material.light for material in materials], np.float32).T
        self._pattern = np.array([material.pattern for material in materials])
        self._tile_m = np.array([material.tile_m for material in materials], np.float32)
        self._emission = np.array([material.emission for material in materials], np.float32)
        self._specular = np.array([material.specular for material in materials], np.float32)
        self._shift = random.random((2, len(materials)), np.float32)
        self._shift[:, [material.is_once for material in materials]] = 0.5
        self._ground = (random.uniform(0.3, 1.0) + random.uniform(-0.1, 0.1, 3)).astype(np.float32)

    def view(self) -> View:
        """The picture, with antialiased edges."""
        camera = self._camera
        rays = camera.rays()
        points = intersect(self._solids, camera.origin, rays)
        hits = points.hits
        lit = self._illumination.denoised(self._illumination.irradiance(points), points.face)
        colour = self._colour(points, rays, lit)
        self._antialias(colour, lit, points)
        mirrored = np.flatnonzero((hits.solid >= 0) & (self._specular[hits.solid] > 0))
        if mirrored.size:
            self._reflect(colour, points, rays, mirrored)
        shape = (camera.height, camera.width)
        met = hits.solid >= 0
        length = np.linalg.norm(rays, axis=0)
        return View(
            np.moveaxis(colour.reshape(3, *shape), 0, -1),
            np.where(met, hits.distance, 0).reshape(shape),
            np.where(met, self._specular[hits.solid], 0).reshape(shape),
            np.abs((points.normal * rays).sum(0) / length).reshape(shape),
        )

    def _colour(self, points: SurfacePoints, rays: Floats, lit: Floats) -> Floats:
        """(3, N) light that points reflect and emit towards the camera."""
        solid = np.maximum(points.hits.solid, 0)
        amount = self._texture(points, rays, solid)
        dark = self._dark.take(solid, 1)
        albedo = dark + (self._light.take(solid, 1) - dark) * amount
        colour = albedo * (lit + self._emission[solid])
        out = points.hits.solid < 0
        colour[:, out] = self._outdoors(rays[:, out])
        return colour

    def _texture(self, points: SurfacePoints, rays: Floats, solid: npt.NDArray[np.int32]) -> Floats:
        """Values (N) of the pattern from dark to light, faded where it is finer than pixels."""
        tile_m, pattern = self._tile_m[solid], self._pattern[solid]
        x, y = points.across / tile_m + self._shift.take(solid, 1)
        slant = np.abs((points.normal * rays).sum(0)) / np.linalg.norm(rays, axis=0)
        footprint_m = points.hits.distance / self._camera.focal_px / np.maximum(slant, 0.05)
        fade = 1 / (1 + np.square(footprint_m / tile_m * (TILE_PX / 6)))
        tiles = self._room.materials.tiles
        mean = tiles.mean((1, 2))[pattern]
        return np.asarray(mean + (sample_pattern(tiles, pattern, x, y) - mean) * fade, np.float32)

    def _outdoors(self, rays: Floats) -> Floats:
        """(3, N) colours of the sky and the ground outdoors, a few times as bright as indoors."""
        if not self._room.is_day:
            return np.full((3, rays.shape[1]), 0.01, np.float32)
        up = rays[1] / np.linalg.norm(rays, axis=0)
        around = np.arctan2(rays[0], rays[2]) / np.pi
        tiles, pattern = self._room.materials.tiles, np.zeros(up.shape, np.int64)  # the softest
        skyline = 0.5 * sample_pattern(tiles, pattern, around * 2, np.zeros_like(up)) - 0.1
        ground = (0.15 + sample_pattern(tiles, pattern, around * 3, up * 2)) * self._ground[:, None]
        sky = np.array([1.5, 1.6, 1.7], np.float32)[:, None] * (1 + 0.3 * up)
        bright = np.where(up < skyline, ground, sky)
        return np.asarray(bright * (4 * self._illumination.ambient() + 0.3), np.float32)

    def _reflect(
        self, colour: Floats, points: SurfacePoints, rays: Floats, some: npt.NDArray[np.int64]
    ) -> None:
        """Add reflections in mirrors, and faint ones on screens and metal."""
        normal = points.normal[:, some]
        away = rays[:, some] - 2 * (rays[:, some] * normal).sum(0) * normal
        seen = intersect(self._solids, points.at[:, some] + normal * RAY_OFFSET_M, away)
        specular = self._specular[points.hits.solid[some]]
        face, lit = np.full(rays.shape[1], -1), np.zeros_like(colour)
        face[some], lit[:, some] = seen.face, self._illumination.irradiance(seen)
        lit = self._illumination.denoised(lit, face)
        mirrored = self._colour(seen, away, lit[:, some])
        colour[:, some] += (mirrored - colour[:, some]) * specular

    def _antialias(self, colour: Floats, lit: Floats, points: SurfacePoints) -> None:
        """Three more rays through pixels at edges, lit as a neighbour on the same face."""
        camera, face = self._camera, points.face
        index = np.arange(face.size).reshape(camera.height, camera.width)
        index = np.pad(index, 1, mode="edge")
        places = [index[1:-1, 1:-1], index[1:-1, :-2], index[1:-1, 2:], index[:-2, 1:-1]]
        around = np.stack([place.ravel() for place in (*places, index[2:, 1:-1])])
        some = np.flatnonzero((face[around] != face).any(0))
        near = around[:, some]
        total = np.minimum(colour[:, some], _WHITE)
        for shift in ((-0.3, 0.35), (0.35, 0.3), (0.1, -0.35)):
            rays = camera.rays(shift)[:, some]
            found = intersect(self._solids, camera.origin, rays)
            alike = (face[near] == found.face).argmax(0)
            light = lit[:, near[alike, np.arange(some.size)]]
            total += np.minimum(self._colour(found, rays, light), _WHITE)
        colour[:, some] = total / 4
