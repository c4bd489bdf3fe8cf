"""Camera poses in a room, and camera rays."""

import math
from typing import NamedTuple

import numpy as np

from depthcli.datasets.rooms.furnish import Room
from depthcli.datasets.rooms.patterns import Floats
from depthcli.datasets.rooms.solids import Solids, Vector, rotation

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
