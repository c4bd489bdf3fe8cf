"""Irradiance of points: direct light of lamps and windows, and ambient light."""

from itertools import product

import numpy as np
import numpy.typing as npt

from depthcli.datasets.rooms.furnish import Room
from depthcli.datasets.rooms.lighting import Light
from depthcli.datasets.rooms.patterns import Floats
from depthcli.datasets.rooms.solids import Solids
from depthcli.datasets.rooms.surface import RAY_OFFSET_M, SurfacePoints

_STRATA = 4  # 4 × 4 pixels share the samples of a light, each with one
_INDIRECT, _DIRECT = 0.3, 0.6  # shares of a lamp's power in ambient and in direct light
_OCCLUSION_RANGE_M = 0.9  # of ambient occlusion


class Illumination:
    """The light of a room.

    Args:
        room: has the lamps.
        solids: cast the shadows.
        size: width and height of the picture, px.
        random: generator of the samples.
    """

    def __init__(
        self, room: Room, solids: Solids, size: tuple[int, int], random: np.random.Generator
    ) -> None:
        self._room, self._solids, self._size, self._random = room, solids, size, random
        self._lights = room.lights

    def irradiance(self, points: SurfacePoints) -> Floats:
        """(3, N) light that falls on points: one shadow ray and one occlusion ray for each."""
        start = points.at + points.normal * RAY_OFFSET_M
        count = start.shape[1]
        # Cosine-weighted directions: points on a sphere that touches the surface.
        height, azimuth = self._stratified(count)
        ring = np.sqrt(1 - height * height)
        away = np.stack([ring * np.cos(np.pi * azimuth), height, ring * np.sin(np.pi * azimuth)])
        away = points.normal + np.float32(0.98) * away
        near = self._solids.cast(start, away, _OCCLUSION_RANGE_M).distance / _OCCLUSION_RANGE_M
        around = self.ambient() * (0.8 + 0.2 * points.normal[1]) * (0.15 + 0.85 * near)
        lights = self._lights
        if not lights:
            return np.asarray(around, np.float32)
        strength = np.stack([_unoccluded(light, points) for light in lights])
        tint = np.array([light.tint for light in lights], np.float32)
        direct = np.einsum("ln,lc->cn", strength, tint)
        # One lamp, sampled in proportion to its light, decides the visibility of all of them.
        total = np.cumsum(strength, 0)
        turn = (self._stratified(count) + 1) / 2
        share = (turn[0] + np.floor(turn[1] * _STRATA)) / _STRATA
        chosen = (share * total[-1] > total[:-1]).sum(0)
        seen = np.flatnonzero((total[-1] > 1e-3) & (points.hits.solid >= 0))
        to = self._lamp_points(chosen)[:, seen] - start[:, seen]
        blocked = self._solids.cast(start.take(seen, 1), to, 1.0).solid >= 0
        direct[:, seen[blocked]] = 0
        return np.asarray(around + direct, np.float32)

    def _lamp_points(self, chosen: npt.NDArray[np.int64]) -> Floats:
        """A random point (3, N) on each of the chosen lamps."""
        lights = self._lights
        centre = np.array([light.centre for light in lights], np.float32)[chosen]
        across = np.array([light.across for light in lights], np.float32)[chosen]
        on = centre.T + np.einsum("kn,nkc->cn", self._stratified(len(chosen)), across)
        return np.asarray(on, np.float32)

    def ambient(self) -> Floats:
        """(3, 1) ambient light, reflected by walls."""
        shell = self._room.shell
        area = shell.width * shell.depth + (shell.width + shell.depth) * shell.height
        power = sum((np.array(light.tint) * light.power for light in self._lights), np.zeros(3))
        return (_INDIRECT * power / area + 0.02).astype(np.float32)[:, None]

    def _stratified(self, count: int) -> Floats:
        """Stratified samples (2, N) in [-1, 1], each in the cell of a grid given by its pixel."""
        jitter = self._random.random((2, count), np.float32)
        if count == self._size[0] * self._size[1]:
            y, x = np.divmod(np.arange(count), self._size[0])
            jitter += np.stack([x % _STRATA, y % _STRATA])
            jitter /= _STRATA
        return (2 * jitter - 1).astype(np.float32)

    def denoised(self, light: Floats, face: npt.NDArray[np.int64]) -> Floats:
        """The mean of the light around each pixel on the same face: 4 × 4, then a wider 3 × 3."""
        shape = self._size[::-1]
        face, grid = face.reshape(shape), light.reshape(3, *shape)
        for steps in (range(-1, _STRATA - 1), (-2, 0, 2)):
            total, weight = np.zeros_like(grid), np.zeros(shape, np.float32)
            for shift in product(steps, steps):
                same = np.roll(face, shift, (0, 1)) == face
                total += np.roll(grid, shift, (1, 2)) * same
                weight += same
            grid = total / weight
        return grid.reshape(3, -1)


def _unoccluded(light: Light, points: SurfacePoints) -> Floats:
    """Light (N) of a lamp's centre at points, without occlusion."""
    to = np.array(light.centre, np.float32)[:, None] - points.at
    square = (to * to).sum(0)
    cos = (points.normal * to).sum(0) / np.sqrt(square)
    if any(light.facing):
        cos *= np.maximum(-np.einsum("i,in->n", light.facing, to), 0) / np.sqrt(square)
    return np.asarray(light.power * _DIRECT * np.maximum(cos, 0) / (square + 0.3), np.float32)
