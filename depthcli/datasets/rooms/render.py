"""What a camera sees: colours and exact depth."""

from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from depthcli.datasets.rooms.camera import Camera
from depthcli.datasets.rooms.furnish import Light, Room
from depthcli.datasets.rooms.looks import TILE_PX, Floats
from depthcli.datasets.rooms.solids import Hits, Solids

_STEP_M = 1e-3  # how far above a surface a ray starts, so that it does not meet that again
_WHITE = 1.5  # what is brighter counts as this at edges, which else would be jagged
_STRATA = 4  # 4 × 4 pixels share the samples of a light, each with one
_BOUNCED, _DIRECT = 0.3, 0.6  # of a lamp's power: in the light all around, and on its way
_OPEN_M = 0.9  # how far away something still dims the light from all around


class View(NamedTuple):
    """A picture before any sensor.

    Attributes:
        light: (H, W, 3) float32 linear RGB, 1 for white under the room's usual light.
        depth_m: (H, W) float32 metres along the camera axis, 0 where nothing is met.
        gloss: (H, W) float32 share of mirror reflection in [0, 1].
        slant: (H, W) float32 cosine of the angle between ray and surface.
    """

    light: Floats
    depth_m: Floats
    gloss: Floats
    slant: Floats


class _Points(NamedTuple):
    """What some rays have met: (3, N) points, (3, N) normals, (2, N) coordinates, and the hits."""

    at: Floats
    normal: Floats
    across: Floats
    hits: Hits

    @property
    def face(self) -> npt.NDArray[np.int64]:
        """(N) number of the solid's side, which is lit alike."""
        axis: npt.NDArray[np.int64] = np.abs(self.normal).argmax(0)
        return 3 * self.hits.solid + axis


class Renderer:
    """One room, seen by one camera.

    Args:
        room: what is seen.
        solids: its solids.
        camera: who sees.
        random: chance of the samples of lights.
    """

    def __init__(
        self, room: Room, solids: Solids, camera: Camera, random: np.random.Generator
    ) -> None:
        self._room, self._solids, self._camera, self._random = room, solids, camera, random
        looks = [part.look for part in solids.parts]
        self._dark = np.array([look.dark for look in looks], np.float32).T
        self._light = np.array([look.light for look in looks], np.float32).T
        self._pattern = np.array([look.pattern for look in looks])
        self._tile_m = np.array([look.tile_m for look in looks], np.float32)
        self._glow = np.array([look.glow for look in looks], np.float32)
        self._gloss = np.array([look.gloss for look in looks], np.float32)
        self._shift = random.random((2, len(looks)), np.float32)
        self._shift[:, [look.tile_m_is_size for look in looks]] = 0.5
        self._ground = (random.uniform(0.3, 1.0) + random.uniform(-0.1, 0.1, 3)).astype(np.float32)

    def view(self) -> View:
        """The picture, with the edges of things smoothed."""
        camera = self._camera
        rays = camera.rays()
        points = self._meet(camera.origin, rays)
        hits = points.hits
        lit = self._smooth(self._lit(points), points.face)
        colour = self._colour(points, rays, lit)
        self._soften(colour, lit, points)
        mirrored = np.flatnonzero((hits.solid >= 0) & (self._gloss[hits.solid] > 0))
        if mirrored.size:
            self._reflect(colour, points, rays, mirrored)
        shape = (camera.height, camera.width)
        met = hits.solid >= 0
        length = np.linalg.norm(rays, axis=0)
        return View(
            np.moveaxis(colour.reshape(3, *shape), 0, -1),
            np.where(met, hits.distance, 0).reshape(shape),
            np.where(met, self._gloss[hits.solid], 0).reshape(shape),
            np.abs((points.normal * rays).sum(0) / length).reshape(shape),
        )

    def _meet(self, origin: Floats, rays: Floats) -> _Points:
        hits = self._solids.cast(origin, rays)
        met = hits.solid >= 0
        at = origin + rays * np.where(met, hits.distance, 0)
        normal, across = self._solids.surface(at, np.maximum(hits.solid, 0))
        return _Points(at, normal, across, hits)

    def _lit(self, points: _Points) -> Floats:
        """(3, N) light that falls on points: one shadow ray each, and one for what is near."""
        start = points.at + points.normal * _STEP_M
        count = start.shape[1]
        # Directions spread as the cosine: on a sphere that touches the surface.
        height, azimuth = self._strata(count)
        ring = np.sqrt(1 - height * height)
        away = np.stack([ring * np.cos(np.pi * azimuth), height, ring * np.sin(np.pi * azimuth)])
        away = points.normal + np.float32(0.98) * away
        near = self._solids.cast(start, away, _OPEN_M).distance / _OPEN_M
        around = self._ambient() * (0.8 + 0.2 * points.normal[1]) * (0.15 + 0.85 * near)
        lights = self._room.lights
        if not lights:
            return np.asarray(around, np.float32)
        strength = np.stack([_unblocked(light, points) for light in lights])
        tint = np.array([light.tint for light in lights], np.float32)
        direct = np.einsum("ln,lc->cn", strength, tint)
        # One lamp of several, each as often as it matters, tells whether they all are seen.
        total = np.cumsum(strength, 0)
        turn = (self._strata(count) + 1) / 2
        share = (turn[0] + np.floor(turn[1] * _STRATA)) / _STRATA
        chosen = (share * total[-1] > total[:-1]).sum(0)
        seen = np.flatnonzero((total[-1] > 1e-3) & (points.hits.solid >= 0))
        to = self._on_lamp(chosen)[:, seen] - start[:, seen]
        blocked = self._solids.cast(start.take(seen, 1), to, 1.0).solid >= 0
        direct[:, seen[blocked]] = 0
        return np.asarray(around + direct, np.float32)

    def _on_lamp(self, chosen: npt.NDArray[np.int64]) -> Floats:
        """A point (3, N) of each of the lamps."""
        lights = self._room.lights
        centre = np.array([light.centre for light in lights], np.float32)[chosen]
        across = np.array([light.across for light in lights], np.float32)[chosen]
        on = centre.T + np.einsum("kn,nkc->cn", self._strata(len(chosen)), across)
        return np.asarray(on, np.float32)

    def _ambient(self) -> Floats:
        """(3, 1) light from all around, which walls have sent on."""
        shell = self._room.shell
        area = shell.width * shell.depth + (shell.width + shell.depth) * shell.height
        power = sum(
            (np.array(light.tint) * light.power for light in self._room.lights), np.zeros(3)
        )
        return (_BOUNCED * power / area + 0.02).astype(np.float32)[:, None]

    def _strata(self, count: int) -> Floats:
        """Points (2, N) in [-1, 1], each in its own cell of a grid, by its pixel."""
        jitter = self._random.random((2, count), np.float32)
        if count == self._camera.width * self._camera.height:
            y, x = np.divmod(np.arange(count), self._camera.width)
            jitter += np.stack([x % _STRATA, y % _STRATA])
            jitter /= _STRATA
        return (2 * jitter - 1).astype(np.float32)

    def _smooth(self, light: Floats, face: npt.NDArray[np.int64]) -> Floats:
        """The mean of the light around each pixel on the same face: 4 × 4, then a wider 3 × 3."""
        shape = (self._camera.height, self._camera.width)
        face, grid = face.reshape(shape), light.reshape(3, *shape)
        for steps in (range(-1, _STRATA - 1), (-2, 0, 2)):
            total, weight = np.zeros_like(grid), np.zeros(shape, np.float32)
            for shift in product(steps, steps):
                same = np.roll(face, shift, (0, 1)) == face
                total += np.roll(grid, shift, (1, 2)) * same
                weight += same
            grid = total / weight
        return grid.reshape(3, -1)

    def _colour(self, points: _Points, rays: Floats, lit: Floats) -> Floats:
        """(3, N) light that comes from points towards the camera."""
        solid = np.maximum(points.hits.solid, 0)
        amount = self._texture(points, rays, solid)
        dark = self._dark.take(solid, 1)
        albedo = dark + (self._light.take(solid, 1) - dark) * amount
        colour = albedo * (lit + self._glow[solid])
        out = points.hits.solid < 0
        colour[:, out] = self._outdoors(rays[:, out])
        return colour

    def _texture(self, points: _Points, rays: Floats, solid: npt.NDArray[np.int32]) -> Floats:
        """Where between dark and light (N) the pattern is, faded where it is finer than pixels."""
        tile_m, pattern = self._tile_m[solid], self._pattern[solid]
        x, y = points.across / tile_m + self._shift.take(solid, 1)
        slant = np.abs((points.normal * rays).sum(0)) / np.linalg.norm(rays, axis=0)
        footprint_m = points.hits.distance / self._camera.focal_px / np.maximum(slant, 0.05)
        fade = 1 / (1 + np.square(footprint_m / tile_m * (TILE_PX / 6)))
        mean = self._room.looks.tiles.mean((1, 2))[pattern]
        return np.asarray(mean + (self._sample(pattern, x, y) - mean) * fade, np.float32)

    def _sample(self, pattern: npt.NDArray[np.int64], x: Floats, y: Floats) -> Floats:
        """Patterns at coordinates (N), in repetitions, between their pixels."""
        tiles = self._room.looks.tiles.ravel()
        left, top = np.floor(x * TILE_PX).astype(np.int64), np.floor(y * TILE_PX).astype(np.int64)
        part_x = (x * TILE_PX - left).astype(np.float32)
        part_y = (y * TILE_PX - top).astype(np.float32)
        columns = left % TILE_PX, (left + 1) % TILE_PX
        value = np.zeros(x.shape, np.float32)
        for row, share in ((top, 1 - part_y), (top + 1, part_y)):
            start = (pattern * TILE_PX + row % TILE_PX) * TILE_PX
            a, b = (tiles.take(start + column) for column in columns)
            value += share * (a + (b - a) * part_x)
        return value

    def _outdoors(self, rays: Floats) -> Floats:
        """(3, N) sky, and below it what stands and grows before a house, a few times as bright."""
        if not self._room.is_day:
            return np.full((3, rays.shape[1]), 0.01, np.float32)
        up = rays[1] / np.linalg.norm(rays, axis=0)
        around = np.arctan2(rays[0], rays[2]) / np.pi
        pattern = np.zeros(up.shape, np.int64)  # the softest
        skyline = 0.5 * self._sample(pattern, around * 2, np.zeros_like(up)) - 0.1
        ground = (0.15 + self._sample(pattern, around * 3, up * 2)) * self._ground[:, None]
        sky = np.array([1.5, 1.6, 1.7], np.float32)[:, None] * (1 + 0.3 * up)
        bright = np.where(up < skyline, ground, sky)
        return np.asarray(bright * (4 * self._ambient() + 0.3), np.float32)

    def _reflect(
        self, colour: Floats, points: _Points, rays: Floats, some: npt.NDArray[np.int64]
    ) -> None:
        """Mix in what is seen in mirrors, and faintly on screens and metal."""
        normal = points.normal[:, some]
        away = rays[:, some] - 2 * (rays[:, some] * normal).sum(0) * normal
        seen = self._meet(points.at[:, some] + normal * _STEP_M, away)
        gloss = self._gloss[points.hits.solid[some]]
        colour[:, some] = (
            colour[:, some] * (1 - gloss) + self._colour(seen, away, self._lit(seen)) * gloss
        )

    def _soften(self, colour: Floats, lit: Floats, points: _Points) -> None:
        """Three more rays through pixels at edges, in the light of the nearest of the same face."""
        camera, face = self._camera, points.face
        grid = face.reshape(camera.height, camera.width)
        around = np.pad(grid, 1, mode="edge")
        shifts = [(1, 1), (1, 0), (1, 2), (0, 1), (2, 1)]
        shifted = [around[y : y + camera.height, x : x + camera.width] for y, x in shifts]
        some = np.flatnonzero((np.stack(shifted) != grid).any(0))
        index = np.pad(np.arange(face.size).reshape(grid.shape), 1, mode="edge")
        near = np.stack(
            [index[y : y + camera.height, x : x + camera.width].ravel()[some] for y, x in shifts]
        )
        total = np.minimum(colour[:, some], _WHITE)
        for shift in ((-0.3, 0.35), (0.35, 0.3), (0.1, -0.35)):
            rays = camera.rays(shift)[:, some]
            sample = self._meet(camera.origin, rays)
            alike = (face[near] == sample.face).argmax(0)
            total += np.minimum(
                self._colour(sample, rays, lit[:, near[alike, np.arange(some.size)]]), _WHITE
            )
        colour[:, some] = total / 4


def _unblocked(light: Light, points: _Points) -> Floats:
    """Light (N) that a lamp's middle would send to points if nothing were in the way."""
    to = np.array(light.centre, np.float32)[:, None] - points.at
    square = (to * to).sum(0)
    cos = (points.normal * to).sum(0) / np.sqrt(square)
    if any(light.facing):
        cos *= np.maximum(-np.einsum("i,in->n", light.facing, to), 0) / np.sqrt(square)
    return np.asarray(light.power * _DIRECT * np.maximum(cos, 0) / (square + 0.3), np.float32)
