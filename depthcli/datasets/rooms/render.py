"""Rendering a room: colours and exact depth."""

import math
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.core.camera import focal_px_of_hfov
from depthcli.core.options import Sensor
from depthcli.datasets.rooms.materials import TILE_PX, Floats, sample_pattern
from depthcli.datasets.rooms.room import Light, Room, make_room
from depthcli.datasets.rooms.solids import (
    RAY_OFFSET_M,
    Solids,
    SurfacePoints,
    Vector,
    intersect,
    rotation,
)

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


_CLOSE_UP_SHARE = 0.2
_TRIES = 60
_PROBE_COLUMNS = 16  # of the rays that score a view
_MIN_DISTANCE_M, _CLEARANCE_M = 0.3, 0.15
_NEAR_PENALTY = 20.0
_MAX_CANDIDATES = 5


class PinholeCamera(NamedTuple):
    """A pinhole camera."""

    eye: Vector  #: metres
    orientation: Floats  #: (3, 3) from its frame (x right, y up, z ahead) to the room's
    focal_px: float  #: focal length in pixels of the picture
    width: int  #: columns
    height: int  #: rows

    def rays(self, shift_px: tuple[float, float] = (0.0, 0.0)) -> Floats:
        """(3, H·W) rays through the middles of the pixels; their length along z ahead is 1."""
        x = (np.arange(self.width) + 0.5 - self.width / 2 + shift_px[0]) / self.focal_px
        y = (np.arange(self.height) + 0.5 - self.height / 2 + shift_px[1]) / self.focal_px
        columns, rows = np.meshgrid(x, -y)
        ahead = np.stack([columns.ravel(), rows.ravel(), np.ones(columns.size)])
        turned: Floats = np.einsum("ij,jn->in", self.orientation, ahead)
        return turned.astype(np.float32)

    @property
    def origin(self) -> Floats:
        """The eye as (3, 1)."""
        return np.array(self.eye, np.float32)[:, None]


def place_camera(
    random: np.random.Generator, room: Room, solids: Solids, focal_px: float, size: tuple[int, int]
) -> PinholeCamera:
    """The best of a few random hand-held camera poses."""
    middle = (room.shell.width * 0.45, 1.6, room.shell.depth * 0.45)
    best, score, seen = PinholeCamera(middle, _orientation(0, 8, 0), focal_px, *size), -math.inf, 0
    close = bool(room.tabletops) and random.random() < _CLOSE_UP_SHARE
    for _ in range(_TRIES):
        eye, yaw, pitch = _at_table(random, room) if close else _standing(random, room)
        roll = random.normal(0, random.choice([1.0, 5.0]))
        camera = PinholeCamera(eye, _orientation(yaw, pitch, roll), focal_px, *size)
        if not _is_free(camera, room, solids):
            continue
        found = _view_score(camera, solids, close=close)
        if found > score:
            best, score = camera, found
        seen += 1
        if seen == _MAX_CANDIDATES:
            break
    return best


def _orientation(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Floats:
    orientation = rotation(yaw_deg, 1) @ rotation(pitch_deg, 0) @ rotation(roll_deg, 2)
    return orientation.astype(np.float32)


def _standing(random: np.random.Generator, room: Room) -> tuple[Vector, float, float]:
    """A random pose, mostly with the back to a wall, facing the room."""
    shell = room.shell
    height = min(random.triangular(0.5, 1.45, 2.2), shell.height - 0.2)
    x, z = np.array([shell.width, shell.depth]) * random.beta(0.6, 0.6, 2)
    to_middle = math.degrees(math.atan2(shell.width / 2 - x, shell.depth / 2 - z))
    return (x, height, z), random.normal(to_middle, 45), random.normal(10 * (height - 0.6), 9)


def _at_table(random: np.random.Generator, room: Room) -> tuple[Vector, float, float]:
    """A random pose near a table, looking down at it."""
    x, y, z = room.tabletops[random.integers(len(room.tabletops))]
    yaw, pitch, away = random.uniform(0, 360), random.uniform(12, 55), random.uniform(0.5, 1.4)
    across, down = away * math.cos(math.radians(pitch)), away * math.sin(math.radians(pitch))
    eye = (
        x - across * math.sin(math.radians(yaw)),
        min(y + down, 2.2),
        z - across * math.cos(math.radians(yaw)),
    )
    return eye, yaw + random.normal(0, 8), pitch + random.normal(0, 5)


def _is_free(camera: PinholeCamera, room: Room, solids: Solids) -> bool:
    """Whether the camera is inside the room, and away from all solids."""
    x, _, z = camera.eye
    shell = room.shell
    inside = 0 < x < shell.width and 0 < z < shell.depth
    if not inside or (shell.corner and x > shell.corner[0] and z > shell.corner[1]):
        return False
    around = np.hstack([np.eye(3), -np.eye(3)]).astype(np.float32)
    return bool(solids.cast(camera.origin, around, _CLEARANCE_M).solid.max() < 0)


def _view_score(camera: PinholeCamera, solids: Solids, *, close: bool) -> float:
    """Higher for many solids in view, at some distance, and none close to the camera."""
    scale = _PROBE_COLUMNS / camera.width
    small = camera._replace(
        width=_PROBE_COLUMNS,
        height=max(1, round(camera.height * scale)),
        focal_px=camera.focal_px * scale,
    )
    hits = solids.cast(camera.origin, small.rays())
    seen_m = hits.distance[hits.solid >= 0]
    if not seen_m.size or seen_m.min() < _MIN_DISTANCE_M:
        return -_NEAR_PENALTY
    near_share = float((seen_m < (0.4 if close else 0.8)).mean())
    things = min(len(np.unique(hits.solid)), 20) / 8
    way_m = 0.0 if close else min(float(np.median(seen_m)), 3.0) / 1.5
    lost_share = 1 - seen_m.size / hits.solid.size
    return things + way_m - _NEAR_PENALTY * max(0.0, near_share - 0.05) - 3 * lost_share


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


_BASELINE_M, _RANGE_M = 0.075, (0.5, 9.5)
_SAME_SURFACE_PX = 1.5  # neighbours on a slanted surface differ by less in disparity


def photograph(light: Floats, random: np.random.Generator) -> npt.NDArray[np.uint8]:
    """A picture (H, W, 3) RGB uint8 of linear light: exposure, blur, tint, noise, gamma."""
    luma = np.einsum("hwc,c->hw", light, np.array([0.3, 0.6, 0.1], np.float32))
    middle = float(np.exp(np.log(luma + 1e-3).mean()))
    gamma = random.uniform(1.3, 2.1)
    exposed = light * (random.triangular(0.15, 0.38, 0.7) ** gamma / middle)
    exposed *= random.uniform(0.88, 1.12, 3).astype(np.float32)
    height, width = luma.shape
    sigma = min(random.exponential(0.25), 1.0) * width / 256
    if sigma > 0.15:
        exposed = np.asarray(cv2.GaussianBlur(exposed, (0, 0), sigma), np.float32)
    y, x = np.ogrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    exposed *= (1 - random.uniform(0, 0.3) * (x * x + y * y) / 2)[..., None].astype(np.float32)
    grain = random.exponential(0.012)
    noise = random.standard_normal(exposed.shape, np.float32)
    exposed += noise * grain * np.sqrt(np.maximum(exposed, 0) * 0.6 + 0.02)
    # Film and phone cameras compress highlights instead of clipping them.
    knee = np.clip(exposed, 0, None)
    knee = np.where(knee > 0.7, 0.7 + 0.3 * np.tanh((knee - 0.7) / 0.3), knee)
    encoded = knee ** (1 / gamma)
    levels: npt.NDArray[np.uint8] = np.rint(np.clip(encoded, 0, 1) * 255).astype(np.uint8)
    return levels


def kinect(view: View, focal_px: float, random: np.random.Generator) -> Floats:
    """Depth (H, W) in metres of a simulated structured-light sensor, 0 where it measures nothing.

    Noise increases with the square of the distance, disparity is quantized, edges are ragged, and
    there are holes in the projector's shadow (its baseline is 7.5 cm), on mirrors, black screens
    and grazing surfaces, and out of range. Source: Khoshelham and Elberink, Sensors 2012.
    """
    height, width = view.depth_m.shape
    rows, columns = np.mgrid[:height, :width]
    fray = random.normal(0, 0.6, (2, height, width)).round().astype(int)
    depth = view.depth_m[
        np.clip(rows + fray[0], 0, height - 1), np.clip(columns + fray[1], 0, width - 1)
    ]
    with np.errstate(divide="ignore"):
        disparity = (
            _BASELINE_M * focal_px / depth + random.normal(0, 0.05, depth.shape) * width / 640
        )
        step = width / 640 / 8
        measured = _BASELINE_M * focal_px / (np.round(disparity / step) * step)
    shadow = _projector_shadow(view.depth_m, focal_px)
    smooth = cv2.GaussianBlur(random.standard_normal((height, width)), (0, 0), 3) * 10
    weak = view.slant + 0.1 * smooth < 0.16
    shiny = (view.specular > 0.5) | ((view.specular > 0.03) & (smooth > 0))
    out = ~((measured >= _RANGE_M[0]) & (measured <= _RANGE_M[1])) | (view.depth_m == 0)
    return np.where(shadow | weak | shiny | out, 0, measured).astype(np.float32)


def _projector_shadow(depth_m: Floats, focal_px: float) -> npt.NDArray[np.bool_]:
    """(H, W) where a nearer point is on the same ray of the projector, left of the camera's."""
    rows, columns = np.indices(depth_m.shape)
    distance_m = np.where(depth_m > 0, depth_m, np.inf)  # the outdoors shades nothing
    disparity = _BASELINE_M * focal_px / distance_m
    place = columns - disparity + np.ceil(disparity.max())
    nearest = np.zeros((depth_m.shape[0], int(place.max()) + 2))
    for column in (np.floor(place), np.floor(place) + 1):
        np.maximum.at(nearest, (rows, column.astype(int)), disparity)
    lit_by = nearest[rows, np.rint(place).astype(int)]
    return np.asarray(lit_by > disparity + _SAME_SURFACE_PX, np.bool_)


VERSION = 3
"""Increases when the same settings give other pictures."""
TYPICAL_HFOV_DEG = 63.0


class RoomSettings(NamedTuple):
    """The settings that all rooms of a data set depend on."""

    seed: int = 0
    size: tuple[int, int] = (256, 192)  #: width and height, px
    hfov_deg: tuple[float, float] = (30.0, 110.0)  #: narrowest and widest, degrees across
    sensor: Sensor = Sensor.NONE


class Pair(NamedTuple):
    """One picture and its depth."""

    rgb: npt.NDArray[np.uint8]  #: (H, W, 3)
    depth_m: npt.NDArray[np.float32]  #: (H, W) metres along the camera axis, 0 where there is none


def room_focal_px(settings: RoomSettings, index: int) -> float:
    """Focal length of a room's camera in pixels, without rendering."""
    low, high = settings.hfov_deg
    typical = min(max(TYPICAL_HFOV_DEG, low), high)
    random = _random(settings, index, 0)
    hfov_deg = random.triangular(low, typical, high) if low < high else low
    return focal_px_of_hfov(hfov_deg, settings.size[0])


def render_pair(settings: RoomSettings, index: int) -> Pair:
    """Build, furnish, light and render a room.

    Args:
        settings: of all rooms.
        index: number of the room, from 0.
    """
    random = _random(settings, index, 1)
    room = make_room(random)
    solids = room.solids
    focal_px = room_focal_px(settings, index)
    camera = place_camera(random, room, solids, focal_px, settings.size)
    view = Renderer(room, solids, camera, random).view()
    rgb = photograph(view.light, random)
    if settings.sensor is Sensor.KINECT:
        return Pair(rgb, kinect(view, focal_px, random))
    return Pair(rgb, view.depth_m)


def _random(settings: RoomSettings, index: int, purpose: int) -> np.random.Generator:
    return np.random.default_rng([settings.seed, index, purpose])
