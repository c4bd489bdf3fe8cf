"""The light that falls on points: from lamps and windows, and from all around."""

from itertools import product

import numpy as np
import numpy.typing as npt

from depthcli.datasets.rooms.furnish import Room
from depthcli.datasets.rooms.lighting import Light
from depthcli.datasets.rooms.patterns import Floats
from depthcli.datasets.rooms.solids import Solids
from depthcli.datasets.rooms.surface import STEP_M, Points

_STRATA = 4  # 4 × 4 pixels share the samples of a light, each with one
_BOUNCED, _DIRECT = 0.3, 0.6  # of a lamp's power: in the light all around, and on its way
_OPEN_M = 0.9  # how far away something still dims the light from all around


class Illumination:
    """The light of a room.

    Args:
        room: has the lamps.
        solids: throw the shadows.
        size: width and height of the picture, px.
        random: chance of the samples.
    """

    def __init__(
        self, room: Room, solids: Solids, size: tuple[int, int], random: np.random.Generator
    ) -> None:
        self._room, self._solids, self._size, self._random = room, solids, size, random
        self._lights = room.lights

    def on(self, points: Points) -> Floats:
        """(3, N) light that falls on points: one shadow ray each, and one for what is near."""
        start = points.at + points.normal * STEP_M
        count = start.shape[1]
        # Directions spread as the cosine: on a sphere that touches the surface.
        height, azimuth = self._strata(count)
        ring = np.sqrt(1 - height * height)
        away = np.stack([ring * np.cos(np.pi * azimuth), height, ring * np.sin(np.pi * azimuth)])
        away = points.normal + np.float32(0.98) * away
        near = self._solids.cast(start, away, _OPEN_M).distance / _OPEN_M
        around = self.ambient() * (0.8 + 0.2 * points.normal[1]) * (0.15 + 0.85 * near)
        lights = self._lights
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
        lights = self._lights
        centre = np.array([light.centre for light in lights], np.float32)[chosen]
        across = np.array([light.across for light in lights], np.float32)[chosen]
        on = centre.T + np.einsum("kn,nkc->cn", self._strata(len(chosen)), across)
        return np.asarray(on, np.float32)

    def ambient(self) -> Floats:
        """(3, 1) light from all around, which walls have sent on."""
        shell = self._room.shell
        area = shell.width * shell.depth + (shell.width + shell.depth) * shell.height
        power = sum((np.array(light.tint) * light.power for light in self._lights), np.zeros(3))
        return (_BOUNCED * power / area + 0.02).astype(np.float32)[:, None]

    def _strata(self, count: int) -> Floats:
        """Points (2, N) in [-1, 1], each in its own cell of a grid, by its pixel."""
        jitter = self._random.random((2, count), np.float32)
        if count == self._size[0] * self._size[1]:
            y, x = np.divmod(np.arange(count), self._size[0])
            jitter += np.stack([x % _STRATA, y % _STRATA])
            jitter /= _STRATA
        return (2 * jitter - 1).astype(np.float32)

    def smoothed(self, light: Floats, face: npt.NDArray[np.int64]) -> Floats:
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


def _unblocked(light: Light, points: Points) -> Floats:
    """Light (N) that a lamp's middle would send to points if nothing were in the way."""
    to = np.array(light.centre, np.float32)[:, None] - points.at
    square = (to * to).sum(0)
    cos = (points.normal * to).sum(0) / np.sqrt(square)
    if any(light.facing):
        cos *= np.maximum(-np.einsum("i,in->n", light.facing, to), 0) / np.sqrt(square)
    return np.asarray(light.power * _DIRECT * np.maximum(cos, 0) / (square + 0.3), np.float32)
